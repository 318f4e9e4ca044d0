// The model of the sub-images: sub_from_native shifts by whole pixels, (u, v) -> (u - x0, v - y0),
// so the recapture camera of a rectangle has the principal point (cx - x0, cy - y0) and the pose
// of the native image (Y. Wang, arXiv 2503.06818). Rectangles are in native pixels; they may
// overlap and reach beyond the native image.
#pragma once

#include <string>
#include <vector>

#include "rectangle.h"
#include "sub_image/sparse_model.h"

namespace sirpy {

struct RecapturedImage {
  std::string name;
  size_t native = 0;  // index of the native image in the model
  Rectangle stored;
};

// One PINHOLE camera and one image for each of `sub_images`, ids from 1 in their order. An
// observation is in every sub-image that stores its pixel; points that none of them sees are left
// out. Each observation is held against the few rectangles near it, so time is linear in the
// number of observations of `native` and of the result.
// Throws std::invalid_argument when a camera of `native` is not PINHOLE, or an index or a
// rectangle is not possible.
SparseModel SubImageModel(const SparseModel& native,
                          const std::vector<RecapturedImage>& sub_images);

}  // namespace sirpy
