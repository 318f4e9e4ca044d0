#include "surface_model.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>

#include "option_bounds.h"

namespace sirpy {
namespace {

constexpr float kNone = std::numeric_limits<float>::quiet_NaN();
constexpr double kLeastConfidence = 0.1;  // 0 also means that stereo has none
constexpr double kLeastUpward = 0.1;      // share of a wall's points that counts
constexpr double kSpacing = 1.2;          // GSD: how far apart points are at most, about
constexpr double kFarthest = 2;           // reaches of the options: that of a coarse point
constexpr double kNeighbourhood = 3;      // reaches of the options: where a layer has support
constexpr double kSlope = 0.5;            // of a layer that is seen across a gap
constexpr double kFarEdge = 2;            // longest gaps: how far edges are looked for
constexpr double kLowerShare = 0.25;      // of the edges of the strongest layer, that make a layer
constexpr double kSteepest = 0.4;         // nz: what is steeper is not carried along its tangent

// What counts of a point.
struct Sample {
  double x, y, z;
  double slope_x, slope_y;  // of its tangent plane
  double coverage;          // weight in the choice of the layer: ground that its pixel covers
  double precision;         // weight in the layer's height
  double reach;             // units: how far it counts
};

Sample MakeSample(const CloudPoint& point, const SurfaceOptions& options) {
  const bool steep = !(point.nz > kSteepest);
  const double gsd = point.gsd > 0 ? point.gsd : options.reach;
  const double reach = std::clamp(kSpacing * gsd, options.reach, kFarthest * options.reach);
  const double weight = std::max<double>(point.confidence, kLeastConfidence) *
                        std::max<double>(point.nz, kLeastUpward);
  return {point.x,
          point.y,
          point.z,
          steep ? 0 : -double(point.nx) / point.nz,
          steep ? 0 : -double(point.ny) / point.nz,
          weight * gsd * gsd / (reach * reach),
          weight / (gsd * gsd + double(point.sigma) * point.sigma),
          reach};
}

// Samples in the order of their cells, row by row: those of cell i of the window are
// samples[start[i]] .. samples[start[i + 1] - 1].
struct Bins {
  CellWindow window;
  std::vector<int64_t> start;
  std::vector<Sample> samples;
  double farthest = 0;  // reach of a sample
};

Bins BinPoints(const CloudPoint* points, int64_t count, const CellWindow& window,
               const SurfaceOptions& options) {
  Bins bins{window, std::vector<int64_t>(size_t(window.width * window.height) + 1), {}};
  std::vector<int64_t> cell_of(size_t(count), -1);
  for (int64_t i = 0; i < count; ++i) {
    const double column = std::floor(points[i].x / options.cell) - double(window.column);
    const double row = std::floor(-points[i].y / options.cell) - double(window.row);
    if (!(column >= 0 && column < double(window.width) && row >= 0 && row < double(window.height) &&
          std::isfinite(points[i].z))) {
      continue;
    }
    cell_of[size_t(i)] = int64_t(row) * window.width + int64_t(column);
    ++bins.start[size_t(cell_of[size_t(i)]) + 1];
  }
  std::partial_sum(bins.start.begin(), bins.start.end(), bins.start.begin());
  bins.samples.resize(size_t(bins.start.back()));
  std::vector<int64_t> next(bins.start.begin(), bins.start.end() - 1);
  for (int64_t i = 0; i < count; ++i) {
    if (cell_of[size_t(i)] < 0) continue;
    const Sample sample = MakeSample(points[i], options);
    bins.samples[size_t(next[size_t(cell_of[size_t(i)])]++)] = sample;
    bins.farthest = std::max(bins.farthest, sample.reach);
  }
  return bins;
}

// A point as a cell sees it.
struct Seen {
  const Sample* sample;
  double height;    // where its tangent plane meets the centre
  double coverage;  // weights of the sample, less with the distance
  double precision;
  double squared;  // distance from the centre, reaches of the sample
};

// What decides about one cell; its vectors are kept from cell to cell.
class Cell {
 public:
  Cell(const Bins& bins, const SurfaceOptions& options) : bins_(bins), options_(options) {}

  // `column`, `row` in the bins' window.
  float Height(int64_t column, int64_t row) {
    column_ = column;
    row_ = row;
    x_ = (double(bins_.window.column + column) + 0.5) * options_.cell;
    y_ = -(double(bins_.window.row + row) + 0.5) * options_.cell;
    Gather();
    if (seen_.empty()) return kNone;
    std::sort(seen_.begin(), seen_.end(), [](const Seen& a, const Seen& b) {
      return a.height != b.height ? a.height > b.height : a.sample < b.sample;
    });
    const double enough = options_.share * StrongestLayer();
    for (size_t top = 0; top < seen_.size(); ++top) {
      if (layer_[top] < enough) continue;
      const double height = Refined(Mean(seen_[top].height - options_.thickness / 2));
      if (IsNear(height) && IsSupported(height)) return float(height);
    }
    return kNone;
  }

 private:
  // Calls visit(sample, squared distance in its reaches, height at the centre) for the samples
  // within `radius` of the centre and within `reaches` of theirs, until it returns false.
  template <typename Visit>
  void ForSamples(double radius, double reaches, const Visit& visit) const {
    const auto n = int64_t(std::ceil(radius / options_.cell));
    const int64_t first = std::max<int64_t>(column_ - n, 0);
    const int64_t last = std::min(column_ + n, bins_.window.width - 1);
    const int64_t end = std::min(row_ + n, bins_.window.height - 1);
    for (int64_t r = std::max<int64_t>(row_ - n, 0); r <= end; ++r) {
      const int64_t line = r * bins_.window.width;
      const int64_t stop = bins_.start[size_t(line + last) + 1];
      for (int64_t i = bins_.start[size_t(line + first)]; i < stop; ++i) {
        const Sample& sample = bins_.samples[size_t(i)];
        const double dx = x_ - sample.x, dy = y_ - sample.y;
        const double distance = dx * dx + dy * dy;
        const double squared = distance / (sample.reach * sample.reach);
        if (squared > reaches * reaches || distance > radius * radius) continue;
        if (!visit(sample, squared, sample.z + sample.slope_x * dx + sample.slope_y * dy)) return;
      }
    }
  }

  void Gather() {
    seen_.clear();
    ForSamples(bins_.farthest, 1, [&](const Sample& sample, double squared, double height) {
      const double weight = (1 - squared) * (1 - squared);
      seen_.push_back(
          {&sample, height, weight * sample.coverage, weight * sample.precision, squared});
      return true;
    });
  }

  // The weight of the layer below each point, in layer_; returns the largest.
  double StrongestLayer() {
    total_.assign(1, 0);
    for (const Seen& seen : seen_) total_.push_back(total_.back() + seen.coverage);
    layer_.clear();
    size_t end = 0;
    for (size_t top = 0; top < seen_.size(); ++top) {
      while (end < seen_.size() && seen_[end].height >= seen_[top].height - options_.thickness) {
        ++end;
      }
      layer_.push_back(total_[end] - total_[top]);
    }
    return *std::max_element(layer_.begin(), layer_.end());
  }

  bool InLayer(double height, double middle) const {
    return std::abs(height - middle) <= options_.thickness / 2;
  }

  // Of the heights of the layer around `middle`.
  double Mean(double middle) const {
    double sum = 0, weights = 0;
    for (const Seen& seen : seen_) {
      if (!InLayer(seen.height, middle)) continue;
      sum += seen.precision * (seen.height - middle);
      weights += seen.precision;
    }
    return weights > 0 ? middle + sum / weights : middle;
  }

  // A layer begins at its highest point, which may be a stray: its middle is found again.
  double Refined(double middle) const { return Mean(Mean(middle)); }

  bool IsNear(double height) const {
    return std::any_of(seen_.begin(), seen_.end(), [&](const Seen& seen) {
      return seen.squared <= options_.near * options_.near && InLayer(seen.height, height);
    });
  }

  bool IsSupported(double height) const {
    int found = 0;
    ForSamples(kNeighbourhood * options_.reach, 2, [&](const Sample&, double, double seen) {
      found += InLayer(seen, height);
      return found < options_.support;
    });
    return found >= options_.support;
  }

  const Bins& bins_;
  const SurfaceOptions& options_;
  int64_t column_ = 0, row_ = 0;  // in the bins' window
  double x_ = 0, y_ = 0;          // of the centre
  std::vector<Seen> seen_;
  std::vector<double> total_, layer_;
};

// One of the 16 directions, in cells.
struct Direction {
  int64_t dx, dy;
};
constexpr std::array<Direction, 8> kAxes = {
    {{1, 0}, {2, 1}, {1, 1}, {1, 2}, {0, 1}, {-1, 2}, {-1, 1}, {-2, 1}}};

struct Edge {
  double height;
  double distance;  // cells
};

// The height of the lowest layer of edges that enough of them belong to.
double LowerSide(std::vector<Edge>* edges, const GapOptions& options) {
  std::sort(edges->begin(), edges->end(), [](const Edge& a, const Edge& b) {
    return a.height != b.height ? a.height < b.height : a.distance < b.distance;
  });
  const auto in_layer = [&](const Edge& lowest, const Edge& edge) {
    const double slope = kSlope * options.cell * (edge.distance + lowest.distance);
    return edge.height >= lowest.height && edge.height <= lowest.height + options.step + slope;
  };
  std::vector<int64_t> sizes;
  for (const Edge& lowest : *edges) {
    sizes.push_back(std::count_if(edges->begin(), edges->end(),
                                  [&](const Edge& edge) { return in_layer(lowest, edge); }));
  }
  const double enough = kLowerShare * double(*std::max_element(sizes.begin(), sizes.end()));
  size_t first = 0;
  while (double(sizes[first]) < enough) ++first;
  const Edge lowest = (*edges)[first];
  double sum = 0, weights = 0;
  for (const Edge& edge : *edges) {
    if (!in_layer(lowest, edge)) continue;
    const double weight = 1 / (edge.distance * edge.distance);
    sum += weight * (edge.height - lowest.height);
    weights += weight;
  }
  return lowest.height + sum / weights;
}

}  // namespace

void SurfaceOptions::Validate() const {
  const auto require = [](bool satisfied, const char* field, double value, const char* bound) {
    RequireOption(satisfied, "SurfaceOptions", field, value, bound);
  };
  require(cell > 0, "cell", cell, "cell > 0");
  require(reach > 0 && reach <= 100 * cell, "reach", reach, "0 < reach <= 100 cells");
  require(thickness > 0, "thickness", thickness, "thickness > 0");
  require(share > 0 && share <= 1, "share", share, "0 < share <= 1");
  require(near > 0, "near", near, "near > 0");
  require(support >= 1, "support", support, "support >= 1");
}

int64_t SurfaceOptions::Margin() const { return int64_t(std::ceil(kNeighbourhood * reach / cell)); }

std::vector<float> SurfaceHeights(const CloudPoint* points, int64_t count, const CellWindow& window,
                                  const SurfaceOptions& options) {
  options.Validate();
  const int64_t margin = options.Margin();
  const CellWindow around = {window.column - margin, window.row - margin, window.width + 2 * margin,
                             window.height + 2 * margin};
  const Bins bins = BinPoints(points, count, around, options);
  std::vector<float> heights;
  heights.reserve(size_t(window.width * window.height));
  Cell cell(bins, options);
  for (int64_t row = 0; row < window.height; ++row) {
    for (int64_t column = 0; column < window.width; ++column) {
      heights.push_back(cell.Height(margin + column, margin + row));
    }
  }
  return heights;
}

int64_t GapOptions::Margin() const { return int64_t(std::ceil(kFarEdge * longest)); }

std::vector<float> FillGaps(const float* heights, int64_t width, int64_t height,
                            const GapOptions& options) {
  // What is seen first from a cell, at most `farthest` cells away; no distance: nothing.
  const auto look = [&](int64_t x, int64_t y, const Direction& way, double farthest) {
    const double length = std::sqrt(double(way.dx * way.dx + way.dy * way.dy));
    for (int64_t i = 1; double(i) * length <= farthest; ++i) {
      const float seen = heights[(y + i * way.dy) * width + x + i * way.dx];
      if (!std::isnan(seen)) return Edge{seen, double(i) * length};
    }
    return Edge{0, 0};
  };
  const auto is_closed = [&](int64_t x, int64_t y) {
    return std::any_of(kAxes.begin(), kAxes.end(), [&](const Direction& axis) {
      const Edge ahead = look(x, y, axis, options.longest);
      if (ahead.distance == 0) return false;
      const double left = options.longest + 1 - ahead.distance;
      return look(x, y, {-axis.dx, -axis.dy}, left).distance > 0;
    });
  };
  const int64_t margin = options.Margin();
  std::vector<float> filled;
  std::vector<Edge> edges;
  for (int64_t y = margin; y < height - margin; ++y) {
    for (int64_t x = margin; x < width - margin; ++x) {
      filled.push_back(heights[y * width + x]);
      if (!std::isnan(filled.back()) || !is_closed(x, y)) continue;
      edges.clear();
      for (const Direction& axis : kAxes) {
        for (const Direction& way : {axis, Direction{-axis.dx, -axis.dy}}) {
          const Edge edge = look(x, y, way, kFarEdge * options.longest);
          if (edge.distance > 0) edges.push_back(edge);
        }
      }
      filled.back() = float(LowerSide(&edges, options));
    }
  }
  return filled;
}

}  // namespace sirpy
