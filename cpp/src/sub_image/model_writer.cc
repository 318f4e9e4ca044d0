#include "sub_image/model_writer.h"

#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstring>
#include <memory>
#include <string>
#include <type_traits>
#include <vector>

#include "error.h"

namespace sirpy {
namespace {

namespace fs = std::filesystem;

constexpr size_t kBuffer = 1 << 18;   // bytes
constexpr int32_t kCameraSensor = 0;  // COLMAP's SensorType::CAMERA

[[noreturn]] void Fail(const fs::path& folder, const std::string& reason) {
  throw OutputError("cannot write the model " + folder.string() + ": " + reason +
                    "; free some space or choose another output folder, then run the same command "
                    "again");
}

// One file of the model in the temporary folder; errors name the folder that it is meant for.
class ModelFile {
 public:
  ModelFile(const fs::path& temporary, const char* name, const fs::path& folder)
      : folder_(folder), file_(std::fopen((temporary / name).c_str(), "wb")) {
    if (file_ == nullptr) Fail(folder_, std::strerror(errno));
    std::setvbuf(file_.get(), nullptr, _IONBF, 0);
    buffer_.reserve(kBuffer);
  }

  template <typename T>
  void Put(T value) {
    Put(&value, 1);
  }

  template <typename T>
  void Put(const T* values, size_t count) {
    static_assert(std::is_arithmetic_v<T>);
    const auto* bytes = reinterpret_cast<const char*>(values);
    buffer_.insert(buffer_.end(), bytes, bytes + count * sizeof(T));
    if (buffer_.size() >= kBuffer) Flush();
  }

  void Finish() {
    Flush();
    errno = 0;
    // A full disk may show only here.
    if (std::fclose(file_.release()) != 0) Fail(folder_, Reason());
  }

 private:
  struct Close {
    void operator()(std::FILE* file) const { std::fclose(file); }
  };

  void Flush() {
    errno = 0;
    if (std::fwrite(buffer_.data(), 1, buffer_.size(), file_.get()) != buffer_.size()) {
      Fail(folder_, Reason());
    }
    buffer_.clear();
  }

  static std::string Reason() {
    return errno != 0 ? std::strerror(errno) : "the disk did not take all of it";
  }

  fs::path folder_;
  std::unique_ptr<std::FILE, Close> file_;
  std::vector<char> buffer_;
};

// A folder beside the model's that becomes it, or is gone when that does not come about.
class TemporaryFolder {
 public:
  explicit TemporaryFolder(const fs::path& folder)
      : folder_(folder),
        path_(folder.parent_path() /
              ("." + folder.filename().string() + "." + std::to_string(getpid()) + ".tmp")) {
    std::error_code error;
    fs::remove_all(path_, error);
    fs::create_directories(path_, error);
    if (error) Fail(folder_, error.message());
  }
  ~TemporaryFolder() {
    std::error_code ignored;
    fs::remove_all(path_, ignored);
  }
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;

  const fs::path& path() const { return path_; }

  void Commit() {
    std::error_code error;
    // Anything but a folder stays, and stands in the way.
    if (fs::is_directory(folder_, error)) fs::remove_all(folder_, error);
    fs::rename(path_, folder_, error);
    if (error) Fail(folder_, error.message());
  }

 private:
  fs::path folder_;
  fs::path path_;
};

void WriteCameras(const SparseModel& model, ModelFile file) {
  file.Put<uint64_t>(model.cameras.size());
  for (const ModelCamera& camera : model.cameras) {
    file.Put<uint32_t>(camera.id);
    file.Put<int32_t>(camera.model);
    file.Put<uint64_t>(static_cast<uint64_t>(camera.width));
    file.Put<uint64_t>(static_cast<uint64_t>(camera.height));
    file.Put(camera.parameters.data(), camera.parameters.size());
  }
  file.Finish();
}

void WriteImages(const SparseModel& model, ModelFile file) {
  file.Put<uint64_t>(model.images.size());
  for (size_t i = 0; i < model.images.size(); ++i) {
    const ModelImage& image = model.images[i];
    file.Put<uint32_t>(image.id);
    file.Put(image.pose.data(), image.pose.size());
    file.Put<uint32_t>(image.camera_id);
    file.Put(image.name.c_str(), image.name.size() + 1);
    const auto first = static_cast<size_t>(model.starts[i]);
    const auto end = static_cast<size_t>(model.starts[i + 1]);
    file.Put<uint64_t>(end - first);
    for (size_t seen = first; seen < end; ++seen) {
      file.Put(&model.xy[2 * seen], 2);
      file.Put<uint64_t>(model.point_ids[static_cast<size_t>(model.point[seen])]);
    }
  }
  file.Finish();
}

// Image and keypoint of each observation, in the order of the points they see.
struct Tracks {
  struct Element {
    uint32_t image_id;
    uint32_t keypoint;
  };
  std::vector<int64_t> starts;  // of each point, and the end
  std::vector<Element> elements;
};

Tracks MakeTracks(const SparseModel& model) {
  Tracks tracks;
  tracks.starts.assign(model.point_ids.size() + 1, 0);
  for (int32_t point : model.point) ++tracks.starts[static_cast<size_t>(point) + 1];
  for (size_t i = 1; i < tracks.starts.size(); ++i) tracks.starts[i] += tracks.starts[i - 1];
  tracks.elements.resize(model.point.size());
  std::vector<int64_t> next(tracks.starts.begin(), tracks.starts.end() - 1);
  for (size_t i = 0; i < model.images.size(); ++i) {
    for (int64_t seen = model.starts[i]; seen < model.starts[i + 1]; ++seen) {
      const auto point = static_cast<size_t>(model.point[static_cast<size_t>(seen)]);
      tracks.elements[static_cast<size_t>(next[point]++)] = {
          model.images[i].id, static_cast<uint32_t>(seen - model.starts[i])};
    }
  }
  return tracks;
}

void WritePoints(const SparseModel& model, ModelFile file) {
  const Tracks tracks = MakeTracks(model);
  file.Put<uint64_t>(model.point_ids.size());
  for (size_t i = 0; i < model.point_ids.size(); ++i) {
    file.Put<uint64_t>(model.point_ids[i]);
    file.Put(&model.xyz[3 * i], 3);
    file.Put(&model.rgb[3 * i], 3);
    file.Put<double>(model.errors[i]);
    file.Put<uint64_t>(static_cast<uint64_t>(tracks.starts[i + 1] - tracks.starts[i]));
    for (int64_t element = tracks.starts[i]; element < tracks.starts[i + 1]; ++element) {
      const Tracks::Element& seen = tracks.elements[static_cast<size_t>(element)];
      file.Put<uint32_t>(seen.image_id);
      file.Put<uint32_t>(seen.keypoint);
    }
  }
  file.Finish();
}

void WriteRigs(const SparseModel& model, ModelFile file) {
  file.Put<uint64_t>(model.cameras.size());
  for (const ModelCamera& camera : model.cameras) {
    file.Put<uint32_t>(camera.id);
    file.Put<uint32_t>(1);  // sensors
    file.Put<int32_t>(kCameraSensor);
    file.Put<uint32_t>(camera.id);
  }
  file.Finish();
}

void WriteFrames(const SparseModel& model, ModelFile file) {
  file.Put<uint64_t>(model.images.size());
  for (const ModelImage& image : model.images) {
    file.Put<uint32_t>(image.id);
    file.Put<uint32_t>(image.camera_id);
    file.Put(image.pose.data(), image.pose.size());
    file.Put<uint32_t>(1);  // images
    file.Put<int32_t>(kCameraSensor);
    file.Put<uint32_t>(image.camera_id);
    file.Put<uint64_t>(image.id);
  }
  file.Finish();
}

}  // namespace

void WriteModel(const SparseModel& model, const fs::path& folder) {
  model.Validate();
  TemporaryFolder temporary(folder);
  const auto file = [&](const char* name) { return ModelFile(temporary.path(), name, folder); };
  WriteCameras(model, file("cameras.bin"));
  WriteImages(model, file("images.bin"));
  WritePoints(model, file("points3D.bin"));
  WriteRigs(model, file("rigs.bin"));
  WriteFrames(model, file("frames.bin"));
  temporary.Commit();
}

}  // namespace sirpy
