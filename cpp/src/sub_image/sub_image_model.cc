#include "sub_image/sub_image_model.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <stdexcept>
#include <unordered_map>
#include <utility>

namespace sirpy {
namespace {

constexpr int64_t kMostBinsOfASide = 256;

// The rectangles of one native image, found by pixel: the image is divided into about as many bins
// as there are rectangles, and each bin lists the rectangles that touch it.
class RectangleBins {
 public:
  struct Entry {
    size_t sub_image;
    Rectangle rectangle;
  };

  explicit RectangleBins(std::vector<Entry> entries) : entries_(std::move(entries)) {
    if (entries_.empty()) return;
    bounds_ = entries_.front().rectangle;
    for (const Entry& entry : entries_) bounds_ = Union(bounds_, entry.rectangle);
    const auto side = static_cast<int64_t>(std::ceil(std::sqrt(entries_.size())));
    const int64_t bins = std::min(2 * side, kMostBinsOfASide);
    bin_width_ = (bounds_.width + bins - 1) / bins;
    bin_height_ = (bounds_.height + bins - 1) / bins;
    columns_ = (bounds_.width - 1) / bin_width_ + 1;
    const int64_t rows = (bounds_.height - 1) / bin_height_ + 1;
    bins_.resize(static_cast<size_t>(columns_ * rows));
    for (uint32_t i = 0; i < entries_.size(); ++i) {
      const Rectangle& r = entries_[i].rectangle;
      for (int64_t row = Row(r.y0); row <= Row(r.y1() - 1); ++row) {
        for (int64_t column = Column(r.x0); column <= Column(r.x1() - 1); ++column) {
          bins_[static_cast<size_t>(row * columns_ + column)].push_back(i);
        }
      }
    }
  }

  // Calls f(sub-image, rectangle) for each rectangle that holds the position, in their order.
  template <typename F>
  void ForEachAt(double x, double y, F f) const {
    const double column = std::floor(x), row = std::floor(y);
    if (!(column >= static_cast<double>(bounds_.x0) && column < static_cast<double>(bounds_.x1()) &&
          row >= static_cast<double>(bounds_.y0) && row < static_cast<double>(bounds_.y1()))) {
      return;
    }
    const auto px = static_cast<int64_t>(column), py = static_cast<int64_t>(row);
    for (uint32_t i : bins_[static_cast<size_t>(Row(py) * columns_ + Column(px))]) {
      const Rectangle& r = entries_[i].rectangle;
      if (r.x0 <= px && px < r.x1() && r.y0 <= py && py < r.y1()) f(entries_[i].sub_image, r);
    }
  }

 private:
  int64_t Column(int64_t x) const { return (x - bounds_.x0) / bin_width_; }
  int64_t Row(int64_t y) const { return (y - bounds_.y0) / bin_height_; }

  std::vector<Entry> entries_;
  Rectangle bounds_;
  int64_t bin_width_ = 1;
  int64_t bin_height_ = 1;
  int64_t columns_ = 0;
  std::vector<std::vector<uint32_t>> bins_;  // indices of entries, row by row
};

void Require(bool holds, const std::string& what) {
  if (!holds) throw std::invalid_argument("SubImageModel: " + what);
}

std::unordered_map<uint32_t, const ModelCamera*> PinholeCameras(const SparseModel& native) {
  std::unordered_map<uint32_t, const ModelCamera*> cameras;
  for (const ModelCamera& camera : native.cameras) {
    Require(camera.model == kPinhole && camera.parameters.size() == 4,
            "camera " + std::to_string(camera.id) + " is not PINHOLE");
    cameras.emplace(camera.id, &camera);
  }
  return cameras;
}

// Cameras and images without observations.
SparseModel RecapturedCameras(const SparseModel& native,
                              const std::vector<RecapturedImage>& sub_images) {
  const auto cameras = PinholeCameras(native);
  SparseModel model;
  for (const RecapturedImage& sub : sub_images) {
    Require(sub.native < native.images.size(), "there is no native image for " + sub.name);
    Require(sub.stored.width > 0 && sub.stored.height > 0, sub.name + " has no pixels");
    const ModelImage& image = native.images[sub.native];
    const auto camera = cameras.find(image.camera_id);
    Require(camera != cameras.end(), image.name + " has no camera");
    const std::vector<double>& p = camera->second->parameters;
    const auto id = static_cast<uint32_t>(model.images.size() + 1);
    model.cameras.push_back({id,
                             kPinhole,
                             sub.stored.width,
                             sub.stored.height,
                             {p[0], p[1], p[2] - static_cast<double>(sub.stored.x0),
                              p[3] - static_cast<double>(sub.stored.y0)}});
    model.images.push_back({id, id, sub.name, image.pose});
  }
  return model;
}

// Calls f(sub-image, observation, rectangle) for all observations in all sub-images.
template <typename F>
void ForEachRecaptured(const SparseModel& native, const std::vector<RectangleBins>& bins, F f) {
  for (size_t image = 0; image < native.images.size(); ++image) {
    for (int64_t i = native.starts[image]; i < native.starts[image + 1]; ++i) {
      const auto seen = static_cast<size_t>(i);
      bins[image].ForEachAt(native.xy[2 * seen], native.xy[2 * seen + 1],
                            [&](size_t sub, const Rectangle& r) { f(sub, seen, r); });
    }
  }
}

// `model`, whose observations name points of `native`, with those that it sees, in their order.
SparseModel WithPoints(SparseModel model, const SparseModel& native) {
  std::vector<int32_t> index(native.point_ids.size(), -1);
  for (int32_t point : model.point) index[static_cast<size_t>(point)] = 0;
  int32_t count = 0;
  for (size_t i = 0; i < index.size(); ++i) {
    if (index[i] < 0) continue;
    index[i] = count++;
    model.point_ids.push_back(native.point_ids[i]);
    model.xyz.insert(model.xyz.end(), &native.xyz[3 * i], &native.xyz[3 * i] + 3);
    model.rgb.insert(model.rgb.end(), &native.rgb[3 * i], &native.rgb[3 * i] + 3);
    model.errors.push_back(native.errors[i]);
  }
  for (int32_t& point : model.point) point = index[static_cast<size_t>(point)];
  return model;
}

}  // namespace

SparseModel SubImageModel(const SparseModel& native,
                          const std::vector<RecapturedImage>& sub_images) {
  native.Validate();
  SparseModel model = RecapturedCameras(native, sub_images);
  std::vector<std::vector<RectangleBins::Entry>> entries(native.images.size());
  for (size_t i = 0; i < sub_images.size(); ++i) {
    entries[sub_images[i].native].push_back({i, sub_images[i].stored});
  }
  const std::vector<RectangleBins> bins(std::make_move_iterator(entries.begin()),
                                        std::make_move_iterator(entries.end()));

  model.starts.assign(sub_images.size() + 1, 0);
  ForEachRecaptured(native, bins,
                    [&](size_t sub, size_t, const Rectangle&) { ++model.starts[sub + 1]; });
  for (size_t i = 1; i < model.starts.size(); ++i) model.starts[i] += model.starts[i - 1];
  const auto count = static_cast<size_t>(model.starts.back());
  model.xy.resize(2 * count);
  model.point.resize(count);
  std::vector<int64_t> next(model.starts.begin(), model.starts.end() - 1);
  ForEachRecaptured(native, bins, [&](size_t sub, size_t seen, const Rectangle& r) {
    const auto at = static_cast<size_t>(next[sub]++);
    model.xy[2 * at] = native.xy[2 * seen] - static_cast<double>(r.x0);
    model.xy[2 * at + 1] = native.xy[2 * seen + 1] - static_cast<double>(r.y0);
    model.point[at] = native.point[seen];
  });
  return WithPoints(std::move(model), native);
}

}  // namespace sirpy
