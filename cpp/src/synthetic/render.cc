#include "synthetic/render.h"

#include <algorithm>
#include <cmath>
#include <string>

#include <omp.h>
#include <Eigen/Geometry>

#include "option_bounds.h"
#include "synthetic/noise.h"

namespace sirpy {
namespace {

constexpr float kSunlight = 1.5f, kSkylight = 0.55f;
const Eigen::Vector3f kSkyColour(0.86f, 0.95f, 1.1f), kSunColour(1.04f, 1.0f, 0.93f);
const Eigen::Vector3f kHaze(0.75f, 0.82f, 0.9f);

// Light that comes from the surface along a ray, linear RGB.
Eigen::Vector3f Radiance(const Scene& scene, const Eigen::Vector3d& origin,
                         const Eigen::Vector3d& ray, const Eigen::Vector3d& sun,
                         double pixel_angle) {
  const RayHit hit = scene.surface.Cast(origin, ray);
  if (hit.triangle < 0) return kHaze;
  const Eigen::Vector3d point = origin + hit.t * ray;
  Eigen::Vector3d normal = scene.surface.Normal(hit.triangle);
  if (normal.dot(ray) > 0) normal = -normal;  // thin sheets are seen from below too
  const double slant = std::max(0.25, -normal.dot(ray) / ray.norm());
  const TextureScale scale{scene.finest_detail, hit.t * pixel_angle / std::sqrt(slant)};
  const Eigen::Vector3f colour =
      Reflectance(scene.materials[scene.material_of[hit.triangle]], scene.plan, point, scale);

  Eigen::Vector3f light = kSkylight * static_cast<float>(0.65 + 0.35 * normal.z()) * kSkyColour;
  const double facing = normal.dot(sun);
  if (facing > 0 && scene.surface.Cast(point + 1e-4 * normal, sun).triangle < 0) {
    light += kSunlight * static_cast<float>(facing) * kSunColour;
  }
  return colour.cwiseProduct(light);
}

uint8_t Developed(float linear, double noise) {
  const double level = 255 * std::pow(std::clamp<double>(linear, 0, 1), 1 / 2.2) + noise;
  return static_cast<uint8_t>(std::clamp(std::floor(level + 0.5), 0.0, 255.0));
}

// A normal deviate of place (Box and Muller).
double Gaussian(uint64_t hash) {
  const double radius = std::sqrt(-2 * std::log(1 - Uniform(hash)));
  return radius * std::cos(2 * M_PI * Uniform(Hash(hash)));
}

}  // namespace

void RenderOptions::Validate() const {
  const auto require = [](bool good, const std::string& field, double value,
                          const std::string& bound) {
    RequireOption(good, "RenderOptions", field, value, bound);
  };
  require(samples >= 1 && samples <= 16, "samples", samples, "1 <= samples <= 16");
  require(noise >= 0, "noise", noise, "noise >= 0");
  require(threads >= 0, "threads", threads, "threads >= 0");
  require(sun.z() > 0, "sun.z", sun.z(), "sun.z > 0");
}

std::vector<uint8_t> Render(const Scene& scene, const RayBand& band, const RenderOptions& options) {
  options.Validate();
  std::vector<uint8_t> rgb(static_cast<size_t>(band.rows) * band.columns * 3);
  const Eigen::Vector3d sun = options.sun.normalized();
  const int threads = options.threads > 0 ? options.threads : omp_get_max_threads();
  const auto node = [&](int64_t row, int64_t column) -> Eigen::Map<const Eigen::Vector2d> {
    return Eigen::Map<const Eigen::Vector2d>(band.nodes + (row * (band.columns + 1) + column) * 2);
  };
#pragma omp parallel for schedule(dynamic) num_threads(threads)
  for (int64_t row = 0; row < band.rows; ++row) {
    for (int64_t column = 0; column < band.columns; ++column) {
      const double pixel_angle = (node(row, column + 1) - node(row, column)).norm();
      Eigen::Vector3f sum = Eigen::Vector3f::Zero();
      for (int i = 0; i < options.samples * options.samples; ++i) {
        const double x = (i % options.samples + 0.5) / options.samples;
        const double y = (i / options.samples + 0.5) / options.samples;
        const Eigen::Vector2d ray =
            (1 - y) * ((1 - x) * node(row, column) + x * node(row, column + 1)) +
            y * ((1 - x) * node(row + 1, column) + x * node(row + 1, column + 1));
        sum +=
            Radiance(scene, band.centre, band.world_from_cam * ray.homogeneous(), sun, pixel_angle);
      }
      sum /= static_cast<float>(options.samples * options.samples);
      for (int channel = 0; channel < 3; ++channel) {
        const uint64_t place = Hash(options.seed, band.first_row + row, column, channel);
        const double noise = options.noise > 0 ? options.noise * Gaussian(place) : 0;
        rgb[(row * band.columns + column) * 3 + channel] = Developed(sum[channel], noise);
      }
    }
  }
  return rgb;
}

}  // namespace sirpy
