// Where the planes of a level start: at the coarsest from the sparse points and at random over the
// range, at finer levels from the four nearest planes of the coarser one, in the geometric pass
// from the last pass.
#pragma once

#include <vector>

#include "patch_match/level.h"
#include "patch_match_sir.h"

namespace sirpy::patch_match {

// Planes that own their arrays.
struct PlaneArrays {
  int width = 0;
  int height = 0;
  std::vector<float> rho, gx, gy, cost;
  std::vector<uint16_t> views;

  PlaneArrays() = default;
  // All planes in the middle of the range, worse than anything.
  explicit PlaneArrays(const Level& level);
  Planes View() { return {rho.data(), gx.data(), gy.data(), cost.data(), views.data()}; }
};

// Writes into the first three rows-of-`level.width` arrays of `row` the planes that candidate
// `candidate` proposes for row y.
class PlaneSource {
 public:
  virtual ~PlaneSource() = default;
  virtual int num_candidates() const = 0;
  virtual void FillRow(int y, int candidate, const Planes& row) const = 0;
};

// Half of the candidates near the depth of the nearest sparse point, half anywhere in the range;
// normals are cosine-weighted about the viewing ray.
class RandomPlanes : public PlaneSource {
 public:
  RandomPlanes(const Level& level, const std::vector<SparsePoint>& points);
  int num_candidates() const override { return 4; }
  void FillRow(int y, int candidate, const Planes& row) const override;

 private:
  static constexpr int kCell = 4;  // pixels of the level that share their nearest point
  const Level& level_;
  size_t CellOf(int x, int y) const;  // of a pixel of the window

  int first_column_ = 0;  // cells are counted from the native image's corner
  int first_row_ = 0;
  int cells_across_ = 0;
  std::vector<float> nearest_rho_;  // per cell; empty without points
};

// The planes of the coarser level; candidate 0 is the nearest one.
class CoarserPlanes : public PlaneSource {
 public:
  CoarserPlanes(const Level& level, const PlaneArrays& coarser);
  int num_candidates() const override { return 4; }
  void FillRow(int y, int candidate, const Planes& row) const override;

 private:
  const Level& level_;
  const PlaneArrays& coarser_;
};

// The depth and normal maps of the last pass; pixels without depth keep what they have.
class GivenPlanes : public PlaneSource {
 public:
  GivenPlanes(const Level& level, const float* depth, const float* normal);
  int num_candidates() const override { return 1; }
  void FillRow(int y, int candidate, const Planes& row) const override;

 private:
  const Level& level_;
  const float* depth_;
  const float* normal_;
};

}  // namespace sirpy::patch_match
