#include "sub_image/sub_image_model.h"

#include <cmath>
#include <random>
#include <set>
#include <stdexcept>

#include <gtest/gtest.h>

namespace sirpy {
namespace {

// Two images of 100x80 pixels; the second sees all points that the first sees, mirrored.
SparseModel NativeModel(const std::vector<std::array<double, 2>>& positions) {
  SparseModel model;
  model.cameras = {{3, kPinhole, 100, 80, {90, 91, 50, 40}}};
  model.images = {{1, 3, "a.jpg", {1, 0, 0, 0, 1, 2, 3}}, {2, 3, "b.jpg", {0, 1, 0, 0, 4, 5, 6}}};
  for (int image = 0; image < 2; ++image) {
    for (size_t i = 0; i < positions.size(); ++i) {
      const auto [x, y] = positions[i];
      model.xy.insert(model.xy.end(), {image == 0 ? x : 100 - x, y});
      model.point.push_back(static_cast<int32_t>(i));
    }
    model.starts.push_back(static_cast<int64_t>(model.point.size()));
  }
  for (size_t i = 0; i < positions.size(); ++i) {
    model.point_ids.push_back(10 * i + 1);
    model.xyz.insert(model.xyz.end(), {1.0 * i, 2.0 * i, 3.0 * i});
    model.rgb.insert(model.rgb.end(), {static_cast<uint8_t>(i), 1, 2});
    model.errors.push_back(0.1 * i);
  }
  return model;
}

TEST(SubImageModel, ShiftsByWholePixelsAndSharesTheOverlap) {
  const SparseModel native =
      NativeModel({{10.5, 20.25}, {50, 20}, {49.999, 20}, {99, 79}, {60, 1}});
  // Left and right half with 5 pixels of overlap, without the lowest ten rows.
  const SparseModel model =
      SubImageModel(native, {{"left", 0, {0, 0, 55, 70}}, {"right", 0, {45, 0, 55, 70}}});
  ASSERT_EQ(model.images.size(), 2u);
  EXPECT_EQ(model.images[1].id, 2u);
  EXPECT_EQ(model.images[1].camera_id, 2u);
  EXPECT_EQ(model.images[1].name, "right");
  EXPECT_EQ(model.images[1].pose, native.images[0].pose);
  EXPECT_EQ(model.cameras[1].model, kPinhole);
  EXPECT_EQ(model.cameras[1].width, 55);
  EXPECT_EQ(model.cameras[1].height, 70);
  EXPECT_EQ(model.cameras[1].parameters, (std::vector<double>{90, 91, 5, 40}));
  EXPECT_EQ(model.starts, (std::vector<int64_t>{0, 3, 6}));
  // Point 31, which none sees, is left out: 1, 11, 21, 41 remain.
  EXPECT_EQ(model.point_ids, (std::vector<uint64_t>{1, 11, 21, 41}));
  EXPECT_EQ(model.point, (std::vector<int32_t>{0, 1, 2, 1, 2, 3}));
  EXPECT_EQ(model.xy,
            (std::vector<double>{10.5, 20.25, 50, 20, 49.999, 20, 5, 20, 49.999 - 45, 20, 15, 1}));
  EXPECT_EQ(model.xyz[9], 4);
  EXPECT_EQ(model.rgb[9], 4);
  EXPECT_EQ(model.errors[3], 0.4);
}

TEST(SubImageModel, AgreesWithTestingEveryRectangle) {
  std::mt19937 random(5);
  std::uniform_real_distribution<double> anywhere(-20, 120);
  std::uniform_int_distribution<int64_t> corner(-30, 110), side(1, 60);
  for (size_t count : {0, 1, 2, 7, 40, 300}) {
    std::vector<std::array<double, 2>> positions;
    for (int i = 0; i < 500; ++i) {
      // Every other one is exactly on the border of a pixel.
      const double x = anywhere(random), y = anywhere(random);
      positions.push_back(i % 2 ? std::array<double, 2>{x, y}
                                : std::array<double, 2>{std::floor(x), std::floor(y)});
    }
    const SparseModel native = NativeModel(positions);
    std::vector<RecapturedImage> subs;
    for (size_t i = 0; i < count; ++i) {
      subs.push_back({"", i % 2, {corner(random), corner(random), side(random), side(random)}});
    }
    const SparseModel model = SubImageModel(native, subs);
    model.Validate();
    std::set<uint64_t> seen;
    for (size_t i = 0; i < count; ++i) {
      const Rectangle& r = subs[i].stored;
      std::vector<double> xy;
      std::vector<uint64_t> ids, found;
      for (int64_t j = native.starts[subs[i].native]; j < native.starts[subs[i].native + 1]; ++j) {
        const double x = native.xy[2 * j], y = native.xy[2 * j + 1];
        if (x < r.x0 || x >= r.x1() || y < r.y0 || y >= r.y1()) continue;
        xy.insert(xy.end(), {x - r.x0, y - r.y0});
        ids.push_back(native.point_ids[native.point[j]]);
      }
      for (int64_t j = model.starts[i]; j < model.starts[i + 1]; ++j) {
        found.push_back(model.point_ids[model.point[j]]);
      }
      EXPECT_EQ(found, ids);
      EXPECT_EQ(std::vector<double>(&model.xy[2 * model.starts[i]],
                                    &model.xy[2 * model.starts[i]] + 2 * found.size()),
                xy);
      seen.insert(ids.begin(), ids.end());
    }
    EXPECT_EQ(model.point_ids, std::vector<uint64_t>(seen.begin(), seen.end()));
  }
}

TEST(SubImageModel, RefusesWhatCannotBe) {
  SparseModel native = NativeModel({{1, 1}});
  EXPECT_THROW(SubImageModel(native, {{"s", 2, {0, 0, 5, 5}}}), std::invalid_argument);
  EXPECT_THROW(SubImageModel(native, {{"s", 0, {0, 0, 0, 5}}}), std::invalid_argument);
  native.cameras[0].model = 2;
  EXPECT_THROW(SubImageModel(native, {{"s", 0, {0, 0, 5, 5}}}), std::invalid_argument);
}

}  // namespace
}  // namespace sirpy
