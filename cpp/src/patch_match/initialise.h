// Where the planes of a pass start: in the first from the sparse points and at random over the
// range, later from the maps of the pass before, at the same level or one level coarser.
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
  std::vector<uint32_t> views;

  PlaneArrays() = default;
  // All planes in the middle of the range, worse than anything.
  explicit PlaneArrays(const Level& level);
  Planes View() { return {rho.data(), gx.data(), gy.data(), cost.data(), views.data()}; }
};

// Writes into the rows of `level.width` pixels of `row` the planes, and if it has `views` the
// sources, that candidate `candidate` proposes for row y; inverse depth is 0 where it proposes
// none.
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
  // `scale`: pixels of the level per native pixel.
  RandomPlanes(const Level& level, const std::vector<SparsePoint>& points, double scale);
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

// The planes of the pass before: the pixel's own at the same level, the four nearest of a coarser
// one; candidate 0 is the nearest.
class StartPlanes : public PlaneSource {
 public:
  // `doubled`: the maps are one level coarser.
  StartPlanes(const Level& level, const StartMaps& start, bool doubled);
  int num_candidates() const override { return doubled_ ? 4 : 1; }
  void FillRow(int y, int candidate, const Planes& row) const override;
  // Of candidate 0, where the maps say it: standard deviation of the inverse depth, and the level
  // that it comes from.
  void FillKnownRow(int y, float* deviation, uint8_t* level) const;

 private:
  // The pixel of the maps for a pixel of this level, or the next one on its other side.
  int64_t StartPixel(int position, bool other, int64_t begin, int64_t size) const;

  const Level& level_;
  const StartMaps& start_;
  bool doubled_;
};

// The candidates of two sources.
class BothPlanes : public PlaneSource {
 public:
  BothPlanes(const PlaneSource& first, const PlaneSource& second)
      : first_(first), second_(second) {}
  int num_candidates() const override { return first_.num_candidates() + second_.num_candidates(); }
  void FillRow(int y, int candidate, const Planes& row) const override {
    const int count = first_.num_candidates();
    candidate < count ? first_.FillRow(y, candidate, row)
                      : second_.FillRow(y, candidate - count, row);
  }

 private:
  const PlaneSource& first_;
  const PlaneSource& second_;
};

}  // namespace sirpy::patch_match
