#include "sub_image/sparse_model.h"

#include <algorithm>
#include <stdexcept>

namespace sirpy {
namespace {

void Require(bool holds, const char* what) {
  if (!holds) throw std::invalid_argument(std::string("SparseModel: ") + what);
}

}  // namespace

void SparseModel::Validate() const {
  const size_t points = point_ids.size();
  Require(xyz.size() == 3 * points && rgb.size() == 3 * points && errors.size() == points,
          "the arrays of points must have one length");
  Require(starts.size() == images.size() + 1 && starts.front() == 0 &&
              std::is_sorted(starts.begin(), starts.end()) &&
              starts.back() == static_cast<int64_t>(point.size()),
          "starts must hold the ranges of the images' observations");
  Require(xy.size() == 2 * point.size(), "each observation must have one position");
  Require(std::all_of(point.begin(), point.end(),
                      [points](int32_t i) { return i >= 0 && static_cast<size_t>(i) < points; }),
          "an observation must have a point");
}

int NumCameraParameters(int32_t model) {
  // SIMPLE_PINHOLE, PINHOLE, SIMPLE_RADIAL, RADIAL, OPENCV, OPENCV_FISHEYE, FULL_OPENCV, FOV,
  // SIMPLE_RADIAL_FISHEYE, RADIAL_FISHEYE, THIN_PRISM_FISHEYE, RAD_TAN_THIN_PRISM_FISHEYE,
  // SIMPLE_DIVISION, DIVISION, SIMPLE_FISHEYE, FISHEYE
  static constexpr int kNumbers[] = {3, 4, 4, 5, 8, 8, 12, 5, 4, 5, 12, 16, 4, 5, 3, 4};
  return 0 <= model && model < static_cast<int32_t>(std::size(kNumbers)) ? kNumbers[model] : -1;
}

}  // namespace sirpy
