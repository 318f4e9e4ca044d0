#include "sub_image/model_reader.h"

#include <algorithm>
#include <bitset>
#include <cmath>
#include <limits>
#include <unordered_map>
#include <unordered_set>
#include <utility>

#include "sub_image/record_reader.h"

namespace sirpy {
namespace {

namespace fs = std::filesystem;

constexpr int64_t kLargestCameraSide = 1 << 20;  // pixels; beyond it the record is noise
constexpr uint64_t kNoPoint = std::numeric_limits<uint64_t>::max();
// Sizes of records in bytes, without what varies.
constexpr int64_t kCameraSize = 24;
constexpr int64_t kImageSize = 73;
constexpr int64_t kKeypointSize = 24;
constexpr int64_t kPointSize = 51;
constexpr int64_t kTrackElementSize = 8;
constexpr int64_t kRigSize = 8;
constexpr int64_t kSensorSize = 8;
constexpr int64_t kFrameSize = 68;
constexpr int64_t kDataIdSize = 16;

// Marks some of a sequence of keypoints, and tells how many marked ones come before each.
class MarkedKeypoints {
 public:
  void Add(bool marked) {
    if (size_ % 64 == 0) blocks_.push_back({0, marked_});
    if (marked) {
      blocks_.back().bits |= uint64_t{1} << (size_ % 64);
      ++marked_;
    }
    ++size_;
  }

  int64_t size() const { return size_; }

  // -1 when the keypoint is not marked.
  int64_t Rank(int64_t keypoint) const {
    const Block& block = blocks_[static_cast<size_t>(keypoint / 64)];
    const uint64_t bit = uint64_t{1} << (keypoint % 64);
    if ((block.bits & bit) == 0) return -1;
    return block.before + static_cast<int64_t>(std::bitset<64>(block.bits & (bit - 1)).count());
  }

 private:
  struct Block {
    uint64_t bits;
    int64_t before;
  };
  std::vector<Block> blocks_;
  int64_t size_ = 0;
  int64_t marked_ = 0;
};

// What images.bin says.
struct Images {
  std::vector<ModelImage> images;
  std::unordered_map<uint32_t, size_t> index_of;  // by id
  // Keypoints of all images, one image after the other; those with a point are marked.
  std::vector<int64_t> keypoint_starts{0};
  MarkedKeypoints keypoints;
  // The marked keypoints.
  std::vector<int64_t> starts{0};
  std::vector<double> xy;
  std::vector<uint64_t> point_ids;
};

// What points3D.bin says; `of_observation` holds the point of each marked keypoint.
struct Points {
  std::vector<uint64_t> ids;
  std::vector<double> xyz;
  std::vector<uint8_t> rgb;
  std::vector<double> errors;
  std::vector<int32_t> of_observation;
};

std::vector<ModelCamera> ReadCameras(const fs::path& path) {
  RecordReader records(path);
  std::vector<ModelCamera> cameras;
  std::unordered_set<uint32_t> ids;
  for (int64_t left = records.Count(kCameraSize); left > 0; --left) {
    ModelCamera camera;
    camera.id = records.Take<uint32_t>();
    const std::string name = "camera " + std::to_string(camera.id);
    if (!ids.insert(camera.id).second) records.Damaged(name + " is there twice");
    camera.model = records.Take<int32_t>();
    const int parameters = NumCameraParameters(camera.model);
    if (parameters < 0) {
      records.Damaged("there is no camera model " + std::to_string(camera.model));
    }
    const auto width = records.Take<uint64_t>(), height = records.Take<uint64_t>();
    if (std::min(width, height) < 1 || std::max(width, height) > kLargestCameraSide) {
      records.Damaged(name + " has " + std::to_string(width) + "x" + std::to_string(height) +
                      " pixels");
    }
    camera.width = static_cast<int64_t>(width);
    camera.height = static_cast<int64_t>(height);
    for (int i = 0; i < parameters; ++i) {
      camera.parameters.push_back(records.TakeFinite("camera", camera.id));
    }
    cameras.push_back(std::move(camera));
  }
  records.End();
  return cameras;
}

ModelImage ReadImage(RecordReader& records) {
  ModelImage image;
  image.id = records.Take<uint32_t>();
  for (double& value : image.pose) value = records.TakeFinite("the pose of image", image.id);
  double norm = 0;
  for (int i = 0; i < 4; ++i) norm += image.pose[i] * image.pose[i];
  if (norm < 1e-12 || norm > 1e12) {
    records.Damaged("the pose of image " + std::to_string(image.id) + " has no rotation");
  }
  image.camera_id = records.Take<uint32_t>();
  image.name = records.Name();
  return image;
}

Images ReadImages(const fs::path& path, const std::vector<ModelCamera>& cameras) {
  std::unordered_set<uint32_t> camera_ids;
  for (const ModelCamera& camera : cameras) camera_ids.insert(camera.id);
  RecordReader records(path);
  Images read;
  std::unordered_set<std::string> names;
  for (int64_t left = records.Count(kImageSize); left > 0; --left) {
    ModelImage image = ReadImage(records);
    if (image.name.empty()) {
      records.Damaged("image " + std::to_string(image.id) + " has no name");
    }
    if (camera_ids.count(image.camera_id) == 0) {
      records.Damaged("image " + image.name + " has camera " + std::to_string(image.camera_id) +
                      ", which does not exist");
    }
    if (!read.index_of.emplace(image.id, read.images.size()).second ||
        !names.insert(image.name).second) {
      records.Damaged("image " + image.name + " is there twice");
    }
    for (int64_t keypoints = records.Count(kKeypointSize); keypoints > 0; --keypoints) {
      const auto x = records.Take<double>(), y = records.Take<double>();
      const auto point = records.Take<uint64_t>();
      read.keypoints.Add(point != kNoPoint);
      if (point == kNoPoint) continue;
      if (!std::isfinite(x) || !std::isfinite(y)) {
        records.Damaged("an observation of image " + image.name + " is not finite");
      }
      read.xy.insert(read.xy.end(), {x, y});
      read.point_ids.push_back(point);
    }
    read.keypoint_starts.push_back(read.keypoints.size());
    read.starts.push_back(static_cast<int64_t>(read.point_ids.size()));
    read.images.push_back(std::move(image));
  }
  records.End();
  return read;
}

// The observation that a track element means; the image must see the point there.
size_t ReadTrackElement(RecordReader& records, uint64_t point, const Images& images) {
  const auto image_id = records.Take<uint32_t>();
  const int64_t keypoint = records.Take<uint32_t>();
  const auto found = images.index_of.find(image_id);
  if (found == images.index_of.end()) {
    records.Damaged("the track of point " + std::to_string(point) + " names image " +
                    std::to_string(image_id) + ", which does not exist");
  }
  const int64_t first = images.keypoint_starts[found->second];
  const int64_t count = images.keypoint_starts[found->second + 1] - first;
  const int64_t observation = keypoint < count ? images.keypoints.Rank(first + keypoint) : -1;
  if (observation < 0 || images.point_ids[static_cast<size_t>(observation)] != point) {
    records.Damaged("the track of point " + std::to_string(point) + " names keypoint " +
                    std::to_string(keypoint) + " of image " + images.images[found->second].name +
                    ", which does not see it");
  }
  return static_cast<size_t>(observation);
}

void CheckUnique(const std::vector<uint64_t>& ids, const RecordReader& records) {
  std::vector<uint64_t> sorted = ids;
  std::sort(sorted.begin(), sorted.end());
  const auto twin = std::adjacent_find(sorted.begin(), sorted.end());
  if (twin != sorted.end()) {
    records.Damaged("point " + std::to_string(*twin) + " is there twice");
  }
}

void CheckAllInTracks(const std::vector<int32_t>& of_observation, const Images& images,
                      const RecordReader& records) {
  const auto missing = std::find(of_observation.begin(), of_observation.end(), -1);
  if (missing == of_observation.end()) return;
  const int64_t observation = missing - of_observation.begin();
  const auto after = std::upper_bound(images.starts.begin(), images.starts.end(), observation);
  const auto image = static_cast<size_t>(after - images.starts.begin()) - 1;
  records.Damaged("it does not say that image " + images.images[image].name + " sees point " +
                  std::to_string(images.point_ids[static_cast<size_t>(observation)]) +
                  ", as images.bin does");
}

Points ReadPoints(const fs::path& path, const Images& images) {
  RecordReader records(path);
  Points read;
  read.of_observation.assign(images.point_ids.size(), -1);
  const int64_t count = records.Count(kPointSize);
  if (count > std::numeric_limits<int32_t>::max()) records.Damaged("it has more than 2^31 points");
  read.ids.reserve(static_cast<size_t>(count));
  for (int32_t index = 0; index < count; ++index) {
    const auto id = records.Take<uint64_t>();
    read.ids.push_back(id);
    for (int i = 0; i < 3; ++i) read.xyz.push_back(records.TakeFinite("point", id));
    for (int i = 0; i < 3; ++i) read.rgb.push_back(records.Take<uint8_t>());
    read.errors.push_back(records.Take<double>());
    for (int64_t left = records.Count(kTrackElementSize); left > 0; --left) {
      int32_t& of_observation = read.of_observation[ReadTrackElement(records, id, images)];
      if (of_observation >= 0) {
        records.Damaged("point " + std::to_string(id) + " or an element of its track is there " +
                        "twice");
      }
      of_observation = index;
    }
  }
  records.End();
  CheckUnique(read.ids, records);
  CheckAllInTracks(read.of_observation, images, records);
  return read;
}

void CheckRigs(const fs::path& path) {
  RecordReader records(path);
  for (int64_t left = records.Count(kRigSize); left > 0; --left) {
    const auto rig = records.Take<uint32_t>();
    const int64_t sensors = records.Take<uint32_t>();
    for (int64_t sensor = 0; sensor < sensors; ++sensor) {
      records.Skip(kSensorSize);
      // The first is the rig's own frame, the others may have a pose in it.
      if (sensor == 0 || records.Take<uint8_t>() == 0) continue;
      for (int i = 0; i < 7; ++i) records.TakeFinite("the pose of a sensor of rig", rig);
    }
  }
  records.End();
}

void CheckFrames(const fs::path& path) {
  RecordReader records(path);
  for (int64_t left = records.Count(kFrameSize); left > 0; --left) {
    const auto frame = records.Take<uint32_t>();
    records.Take<uint32_t>();  // rig
    for (int i = 0; i < 7; ++i) records.TakeFinite("the pose of frame", frame);
    const int64_t data_ids = records.Take<uint32_t>();
    records.CheckCount(static_cast<uint64_t>(data_ids), kDataIdSize);
    records.Skip(data_ids * kDataIdSize);
  }
  records.End();
}

}  // namespace

SparseModel ReadModel(const fs::path& folder) {
  SparseModel model;
  model.cameras = ReadCameras(folder / "cameras.bin");
  Images images = ReadImages(folder / "images.bin", model.cameras);
  Points points = ReadPoints(folder / "points3D.bin", images);
  std::error_code ignored;  // what cannot be read has been met above
  if (fs::exists(folder / "rigs.bin", ignored)) CheckRigs(folder / "rigs.bin");
  if (fs::exists(folder / "frames.bin", ignored)) CheckFrames(folder / "frames.bin");
  model.images = std::move(images.images);
  model.starts = std::move(images.starts);
  model.xy = std::move(images.xy);
  model.point = std::move(points.of_observation);
  model.point_ids = std::move(points.ids);
  model.xyz = std::move(points.xyz);
  model.rgb = std::move(points.rgb);
  model.errors = std::move(points.errors);
  return model;
}

}  // namespace sirpy
