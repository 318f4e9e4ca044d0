// How a photograph is read between its pixels. Positions are in sub-pixels (sub_pixels.h); beyond
// the outermost pixel centres there is black, COLMAP's rule, whatever the interpolation.
#pragma once

#include <cstdint>

#include "sub_image/image_shape.h"
#include "sub_image/warp_kernels.h"

namespace sirpy {

enum class Interpolation {
  kNearest,
  kBilinear,  // as COLMAP, rounded to nearest
  kBicubic,   // Keys, a = -1/2 (Catmull-Rom), 4 x 4 pixels
  kLanczos,   // 3 lobes, 6 x 6 pixels
};

// Rows above (below) the row of the position, rounded down, that are read.
int RowsAbove(Interpolation interpolation);
int RowsBelow(Interpolation interpolation);

// How rows of such a photograph are sampled, on the best instruction set.
warp::SampleRow ChooseSampleRow(Interpolation interpolation, const ImageShape& photograph);

}  // namespace sirpy
