#include "synthetic/render.h"

#include <algorithm>

#include <gtest/gtest.h>

namespace sirpy {
namespace {

// Painted ground with a wall along y at x = 0, 2 high, and the sun low in the east.
Scene WallScene() {
  Material paint;
  paint.substance = Substance::kPaint;
  return {TownPlan(),
          0.1,
          Surface({{-10, -10, 0},
                   {10, -10, 0},
                   {10, 10, 0},
                   {-10, 10, 0},
                   {0, -10, 0},
                   {0, 10, 0},
                   {0, 10, 2},
                   {0, -10, 2}},
                  {{0, 1, 2}, {0, 2, 3}, {4, 5, 6}, {4, 6, 7}}),
          {paint},
          {0, 0, 0, 0}};
}

struct View {
  std::vector<double> nodes;
  RayBand band;
};

// A nadir camera 10 above the wall that sees 8 x 8 on the ground in `pixels` x `pixels`; world x
// runs to the right.
View Nadir(int64_t pixels) {
  View view;
  for (int64_t row = 0; row <= pixels; ++row) {
    for (int64_t column = 0; column <= pixels; ++column) {
      view.nodes.push_back(0.8 * (static_cast<double>(column) / pixels - 0.5));
      view.nodes.push_back(0.8 * (static_cast<double>(row) / pixels - 0.5));
    }
  }
  view.band = {
      view.nodes.data(), pixels, pixels, 0, {0, 0, 10}, Eigen::Vector3d(1, -1, -1).asDiagonal()};
  return view;
}

TEST(Render, WallThrowsAShadowAsLongAsItIsHigh) {
  RenderOptions options;
  options.noise = 0;
  options.sun = {1, 0, 1};      // 45 degrees: the shadow lies on -2 < x < 0
  const View view = Nadir(80);  // a pixel is 0.1 on the ground
  const std::vector<uint8_t> image = Render(WallScene(), view.band, options);
  const auto level = [&](double x) {
    return image[(40 * 80 + static_cast<int64_t>((x + 4) * 10)) * 3 + 1];
  };
  EXPECT_GT(level(-2.25), level(-1.75) + 60);
  EXPECT_GT(level(1.05), level(-1.05) + 60);
  EXPECT_NEAR(level(-2.25), level(1.05), 10);
}

TEST(Render, ThreadsAndBandsDoNotChangeTheBytes) {
  const Scene scene = MakeScene({5, 60, 1, 0.1});
  RenderOptions options;
  options.threads = 1;
  View view = Nadir(32);
  view.band.centre = {3, 4, 40};
  const std::vector<uint8_t> whole = Render(scene, view.band, options);
  options.threads = 2;
  EXPECT_EQ(Render(scene, view.band, options), whole);

  RayBand lower = view.band;
  lower.nodes += 20 * 33 * 2;
  lower.first_row = 20;
  lower.rows = 12;
  const std::vector<uint8_t> part = Render(scene, lower, options);
  EXPECT_TRUE(std::equal(part.begin(), part.end(), whole.begin() + 20 * 32 * 3));
}

TEST(MakeScene, MoreThanGroundAndEveryTriangleHasAMaterial) {
  const Scene scene = MakeScene({1, 120, 2, 0.1});
  EXPECT_EQ(scene.material_of.size(), scene.surface.triangles().size());
  EXPECT_GT(scene.surface.triangles().size(), 2u * 120 * 120);
  for (const int32_t material : scene.material_of) {
    ASSERT_GE(material, 0);
    ASSERT_LT(material, static_cast<int32_t>(scene.materials.size()));
  }
}

TEST(MakeScene, RoofsAndWallsLookOutwards) {
  // From above, no face of the scene may be seen from behind, but for the undersides of eaves.
  const Scene scene = MakeScene({1, 120, 2, 0.1});
  for (double x = -60; x < 60; x += 0.37) {
    const RayHit hit = scene.surface.Cast({x, 0.3 * x + 1, 100}, {0, 0, -1});
    ASSERT_GE(hit.triangle, 0);
    EXPECT_GT(scene.surface.Normal(hit.triangle).z(), 0);
  }
}

TEST(MakeScene, TowersAndWoodsAreAsTallAsAskedFor) {
  SceneOptions options{6, 120, 2, 0.1};
  const auto highest = [&] {
    const Scene scene = MakeScene(options);
    double height = 0;
    for (const Eigen::Vector3d& vertex : scene.surface.vertices()) {
      height = std::max(height, vertex.z() - TerrainHeight(options.seed, vertex.x(), vertex.y()));
    }
    return height;
  };
  EXPECT_LT(highest(), 20);
  options.tall = 60;
  EXPECT_NEAR(highest(), options.tall, 0.1 * options.tall);
}

TEST(Options, NameFieldValueAndBound) {
  RenderOptions render;
  render.samples = 0;
  EXPECT_THROW(render.Validate(), std::invalid_argument);
  SceneOptions scene;
  scene.half_extent = -1;
  EXPECT_THROW(MakeScene(scene), std::invalid_argument);
  scene = SceneOptions();
  scene.tall = -1;
  EXPECT_THROW(MakeScene(scene), std::invalid_argument);
}

}  // namespace
}  // namespace sirpy
