#include "depth_filter.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

namespace sirpy {
namespace {

// Disjoint sets of pixels. A root holds minus the size of its set; the others their parent.
class PixelSets {
 public:
  explicit PixelSets(int64_t count) : parent_(size_t(count), -1) {}

  int64_t Root(int64_t pixel) {
    while (parent_[pixel] >= 0) {
      const int64_t parent = parent_[pixel];
      if (parent_[parent] >= 0) parent_[pixel] = parent_[parent];  // halves the way
      pixel = parent;
    }
    return pixel;
  }

  void Join(int64_t a, int64_t b) {
    a = Root(a);
    b = Root(b);
    if (a == b) return;
    if (parent_[a] > parent_[b]) std::swap(a, b);  // the larger set stays
    parent_[a] += parent_[b];
    parent_[b] = int32_t(a);
  }

  int64_t Size(int64_t pixel) { return -int64_t(parent_[Root(pixel)]); }

  void Enlarge(int64_t pixel, int64_t by) { parent_[Root(pixel)] -= int32_t(by); }

 private:
  std::vector<int32_t> parent_;
};

// The plane of a pixel, as the depths that it has elsewhere.
class Plane {
 public:
  Plane(const PlaneMap& map, int64_t x, int64_t y)
      : focal_(map.intrinsics(0, 0)), pixel_(y * map.window.width + x) {
    const int64_t area = map.window.Area();
    across_ = map.normal[pixel_] / map.intrinsics(0, 0);
    down_ = map.normal[area + pixel_] / map.intrinsics(1, 1);
    here_ = (map.window.x0 + x + 0.5 - map.intrinsics(0, 2)) * across_ +
            (map.window.y0 + y + 0.5 - map.intrinsics(1, 2)) * down_ +
            map.normal[2 * area + pixel_];
    own_ = double(map.depth[pixel_]) * here_;
    sigma_ = map.sigma ? map.sigma[pixel_] : 0;
  }

  // Whether the pixel (dx, dy) away, of this depth and standard deviation, lies on the plane. The
  // product of the depth and of normal . ray, which is linear in the pixel, is the same all over
  // the plane.
  bool Holds(int dx, int dy, float depth, float sigma, double step, double deviations) const {
    if (!(depth > 0)) return false;
    const double there = here_ + dx * across_ + dy * down_;
    const double off = std::abs(depth * there - own_);
    if (off * focal_ <= step * std::abs(own_)) return true;
    const double spread = sigma_ * sigma_ + double(sigma) * sigma;
    return off * off <= deviations * deviations * spread * there * there;
  }

 private:
  double focal_;
  int64_t pixel_;
  double across_, down_, here_, own_, sigma_;
};

void CheckSize(const Rectangle& window) {
  // Pixels are counted in 32 bits.
  if (window.width < 0 || window.height < 0 || window.Area() > int64_t(1) << 30) {
    throw std::invalid_argument("a window of " + std::to_string(window.width) + " x " +
                                std::to_string(window.height) +
                                " pixels: at most 2^30 are possible");
  }
}

}  // namespace

void SpeckleOptions::Validate() const {
  const auto check = [](double value, double high, const char* field) {
    if (!(value >= 0 && value <= high)) {
      throw std::invalid_argument(std::string("SpeckleOptions::") + field + " = " +
                                  std::to_string(value) + ": it must be 0 to " +
                                  std::to_string(high));
    }
  };
  check(step, 1e6, "step");
  check(deviations, 1e6, "deviations");
  check(double(min_pixels), 1e6, "min_pixels");
}

std::vector<uint8_t> FindSpeckles(const PlaneMap& map, const SpeckleOptions& options) {
  options.Validate();
  CheckSize(map.window);
  const int64_t width = map.window.width, height = map.window.height;
  const float* depth = map.depth;
  const auto sigma = [&](int64_t pixel) { return map.sigma ? map.sigma[pixel] : 0.f; };
  PixelSets sets(width * height);
  for (int64_t y = 0; y < height; ++y) {
    for (int64_t x = 0; x < width; ++x) {
      const int64_t pixel = y * width + x;
      if (!(depth[pixel] > 0)) continue;
      const Plane plane(map, x, y);
      const auto join = [&](int dx, int dy) {
        const int64_t other = pixel + dy * width + dx;
        if (plane.Holds(dx, dy, depth[other], sigma(other), options.step, options.deviations) &&
            Plane(map, x + dx, y + dy)
                .Holds(-dx, -dy, depth[pixel], sigma(pixel), options.step, options.deviations)) {
          sets.Join(pixel, other);
        }
      };
      if (x > 0) join(-1, 0);
      if (y > 0) join(0, -1);
    }
  }
  const auto reaches_border = [&](int64_t pixel) {
    const int64_t lacking = options.min_pixels - sets.Size(pixel);
    if (lacking > 0) sets.Enlarge(pixel, lacking);
  };
  for (int64_t x = 0; x < width && height > 0; ++x) {
    reaches_border(x);
    reaches_border((height - 1) * width + x);
  }
  for (int64_t y = 0; y < height && width > 0; ++y) {
    reaches_border(y * width);
    reaches_border(y * width + width - 1);
  }
  std::vector<uint8_t> speckle(size_t(width * height), 0);
  for (int64_t pixel = 0; pixel < width * height; ++pixel) {
    speckle[pixel] = depth[pixel] > 0 && sets.Size(pixel) < options.min_pixels;
  }
  return speckle;
}

std::vector<float> CoplanarShares(const PlaneMap& map) {
  CheckSize(map.window);
  const int64_t width = map.window.width, height = map.window.height;
  std::vector<float> shares(size_t(width * height), 0);
#pragma omp parallel for
  for (int64_t y = 0; y < height; ++y) {
    for (int64_t x = 0; x < width; ++x) {
      const int64_t pixel = y * width + x;
      if (!(map.depth[pixel] > 0)) continue;
      const Plane plane(map, x, y);
      int inside = 0, coplanar = 0;
      for (int dy = -kCoplanarReach; dy <= kCoplanarReach; dy += kCoplanarReach) {
        for (int dx = -kCoplanarReach; dx <= kCoplanarReach; dx += kCoplanarReach) {
          if ((dx == 0 && dy == 0) || x + dx < 0 || x + dx >= width || y + dy < 0 ||
              y + dy >= height) {
            continue;
          }
          ++inside;
          const int64_t other = pixel + dy * width + dx;
          coplanar += plane.Holds(dx, dy, map.depth[other], map.sigma ? map.sigma[other] : 0,
                                  kCoplanarStep, kCoplanarDeviations);
        }
      }
      shares[pixel] = inside > 0 ? float(coplanar) / float(inside) : 0.f;
    }
  }
  return shares;
}

std::vector<float> BoxMeans(const float* plane, int64_t width, int64_t height, int64_t radius) {
  std::vector<float> rows(size_t(width * height)), means(rows.size());
#pragma omp parallel for
  for (int64_t y = 0; y < height; ++y) {
    for (int64_t x = 0; x < width; ++x) {
      const int64_t first = std::max<int64_t>(x - radius, 0),
                    last = std::min(x + radius, width - 1);
      float sum = 0;
      for (int64_t u = first; u <= last; ++u) sum += plane[y * width + u];
      rows[size_t(y * width + x)] = sum / float(last - first + 1);
    }
  }
#pragma omp parallel for
  for (int64_t y = 0; y < height; ++y) {
    const int64_t first = std::max<int64_t>(y - radius, 0), last = std::min(y + radius, height - 1);
    float* mean = means.data() + y * width;
    for (int64_t v = first; v <= last; ++v) {
      const float* row = rows.data() + v * width;
      for (int64_t x = 0; x < width; ++x) mean[x] += row[x];
    }
    for (int64_t x = 0; x < width; ++x) mean[x] /= float(last - first + 1);
  }
  return means;
}

}  // namespace sirpy
