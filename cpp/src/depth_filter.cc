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

}  // namespace

void SpeckleOptions::Validate() const {
  const auto check = [](double value, double high, const char* field) {
    if (!(value >= 0 && value <= high)) {
      throw std::invalid_argument(std::string("SpeckleOptions::") + field + " = " +
                                  std::to_string(value) + ": it must be 0 to " +
                                  std::to_string(high));
    }
  };
  check(step_x, 1e6, "step_x");
  check(step_y, 1e6, "step_y");
  check(double(min_pixels), 1e6, "min_pixels");
}

std::vector<uint8_t> FindSpeckles(const float* depth, int64_t width, int64_t height,
                                  const SpeckleOptions& options) {
  options.Validate();
  // Pixels are counted in 32 bits.
  if (width < 0 || height < 0 || width * height > int64_t(1) << 30) {
    throw std::invalid_argument("a window of " + std::to_string(width) + " x " +
                                std::to_string(height) + " pixels: at most 2^30 are possible");
  }
  const auto joined = [&](int64_t a, int64_t b, double step) {
    return depth[a] > 0 && depth[b] > 0 &&
           std::abs(double(depth[a]) - depth[b]) <= step * std::min(depth[a], depth[b]);
  };
  PixelSets sets(width * height);
  for (int64_t y = 0; y < height; ++y) {
    for (int64_t x = 0; x < width; ++x) {
      const int64_t pixel = y * width + x;
      if (x > 0 && joined(pixel, pixel - 1, options.step_x)) sets.Join(pixel, pixel - 1);
      if (y > 0 && joined(pixel, pixel - width, options.step_y)) sets.Join(pixel, pixel - width);
    }
  }
  std::vector<uint8_t> speckle(size_t(width * height), 0);
  const auto reaches_border = [&](int64_t pixel) {
    const int64_t lacking = options.min_pixels - sets.Size(pixel);
    if (depth[pixel] > 0 && lacking > 0) sets.Enlarge(pixel, lacking);
  };
  for (int64_t x = 0; x < width && height > 0; ++x) {
    reaches_border(x);
    reaches_border((height - 1) * width + x);
  }
  for (int64_t y = 0; y < height && width > 0; ++y) {
    reaches_border(y * width);
    reaches_border(y * width + width - 1);
  }
  for (int64_t pixel = 0; pixel < width * height; ++pixel) {
    speckle[pixel] = depth[pixel] > 0 && sets.Size(pixel) < options.min_pixels;
  }
  return speckle;
}

}  // namespace sirpy
