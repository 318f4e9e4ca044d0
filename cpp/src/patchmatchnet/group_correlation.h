// Group-wise correlation of PatchmatchNet (Wang et al., CVPR 2021, section 3.2): how alike a pixel
// of the reference and what a source shows of it are, for hypotheses of its depth.
//
// Geometry: the centre of the top-left pixel of a map is at (0, 0), pixels are those of the stage;
// pixel (x, y) of the reference at depth d is seen at (u, v) with z (u, v, 1) =
// source_from_reference (x d, y d, d, 1); z is the depth in the source.
//
// Maps of features are height x width x channels, maps of depths are hypotheses x height x width,
// all without gaps. The result does not change with the instruction set.
#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Core>

namespace sirpy {

// Not owned.
struct FeatureMap {
  const float* features = nullptr;
  int height = 0;
  int width = 0;
  int channels = 0;
};

struct SourceFeatures {
  FeatureMap map;
  Eigen::Matrix<float, 3, 4, Eigen::RowMajor> source_from_reference;
  Eigen::Vector2f behind;  // the (u, v) of what the source cannot see, z <= 1e-3
};

// Rows of the reference, from `first_row` of its map on, and `hypotheses` depths of their pixels.
struct ReferenceRows {
  FeatureMap map;
  const float* depth = nullptr;
  int hypotheses = 0;
  int first_row = 0;
};

// Of each of `groups` groups of neighbouring channels, the mean product of the reference and the
// source, which is bilinear, and 0 beyond its outermost pixels: groups x hypotheses x height x
// width. Throws std::invalid_argument when the channels cannot be grouped so.
std::vector<float> GroupCorrelation(const ReferenceRows& reference, const SourceFeatures& source,
                                    int groups);

}  // namespace sirpy
