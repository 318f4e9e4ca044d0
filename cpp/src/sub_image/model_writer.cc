#include "sub_image/model_writer.h"

#include <cerrno>
#include <cstdio>
#include <memory>
#include <set>
#include <string>
#include <type_traits>
#include <vector>

#include "error.h"
#include "sub_image/partial_file.h"

namespace sirpy {
namespace {

namespace fs = std::filesystem;

constexpr size_t kBuffer = 1 << 18;   // bytes
constexpr int32_t kCameraSensor = 0;  // COLMAP's SensorType::CAMERA

[[noreturn]] void Fail(const fs::path& folder, int error) {
  FailToWrite("the model " + folder.string(), error);
}

[[noreturn]] void Refuse(const fs::path& folder, const std::string& reason) {
  throw OutputError("cannot write the model " + folder.string() + ": " + reason +
                    "; choose another output folder");
}

// One file of the model in the temporary folder; errors name the folder that it is meant for.
class ModelFile {
 public:
  ModelFile(const fs::path& temporary, const char* name, const fs::path& folder)
      : folder_(folder), file_(std::fopen((temporary / name).c_str(), "wb")) {
    if (file_ == nullptr) Fail(folder_, errno);
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
    if (std::fclose(file_.release()) != 0) Fail(folder_, errno);
  }

 private:
  struct Close {
    void operator()(std::FILE* file) const { std::fclose(file); }
  };

  void Flush() {
    errno = 0;
    if (std::fwrite(buffer_.data(), 1, buffer_.size(), file_.get()) != buffer_.size()) {
      Fail(folder_, errno);
    }
    buffer_.clear();
  }

  fs::path folder_;
  std::unique_ptr<std::FILE, Close> file_;
  std::vector<char> buffer_;
};

// Of a model in binary or as text, or what COLMAP's mapper writes beside it.
bool IsOfAModel(const fs::path& name) {
  static const std::set<std::string> kStems = {"cameras", "images", "points3D", "rigs", "frames"};
  if (name == "project.ini") return true;
  return kStems.count(name.stem().string()) > 0 &&
         (name.extension() == ".bin" || name.extension() == ".txt");
}

// `folder` without "." and "..", symbolic links and a slash at the end. It will be replaced, so it
// must be one that is safe to remove.
fs::path Replaceable(const fs::path& folder) {
  std::error_code error;
  fs::path path = fs::weakly_canonical(fs::absolute(folder, error), error);
  if (error) Fail(folder, error.value());
  if (!path.has_filename()) path = path.parent_path();
  if (!path.has_filename()) Refuse(folder, "it is no name of a folder");
  if (!fs::is_directory(path, error)) return path;
  if (fs::equivalent(path, fs::current_path(error), error)) {
    Refuse(folder, "it is the folder that the program runs in");
  }
  const fs::directory_iterator entries(path, error);
  if (error) Fail(folder, error.value());
  for (const fs::directory_entry& entry : entries) {
    const fs::path name = entry.path().filename();
    if (!IsOfAModel(name)) Refuse(folder, "it holds " + name.string() + ", no part of a model");
  }
  return path;
}

// A folder beside the model's, with the new model until that takes its name, then with the old one.
class TemporaryFolder {
 public:
  explicit TemporaryFolder(const fs::path& folder)
      : given_(folder), folder_(Replaceable(folder)), temporary_(TemporaryPath(folder_)) {
    std::error_code error;
    fs::remove_all(temporary_, error);
    fs::create_directories(made(), error);
    if (error) Fail(given_, error.value());
  }
  ~TemporaryFolder() {
    std::error_code ignored;
    // Not an old model that could not be put back.
    if (fs::exists(folder_, ignored) || !fs::exists(old(), ignored)) {
      fs::remove_all(temporary_, ignored);
    }
  }
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;

  fs::path made() const { return temporary_ / "new"; }

  void Commit() {
    std::error_code error, ignored;
    // Anything but a folder stays, and stands in the way.
    const bool replaces = fs::is_directory(folder_, ignored);
    if (replaces) fs::rename(folder_, old(), error);
    if (error) Fail(given_, error.value());
    fs::rename(made(), folder_, error);
    if (!error) return;
    if (replaces) fs::rename(old(), folder_, ignored);
    Fail(given_, error.value());
  }

 private:
  fs::path old() const { return temporary_ / "old"; }

  fs::path given_;
  fs::path folder_;
  fs::path temporary_;
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
  const auto file = [&](const char* name) { return ModelFile(temporary.made(), name, folder); };
  WriteCameras(model, file("cameras.bin"));
  WriteImages(model, file("images.bin"));
  WritePoints(model, file("points3D.bin"));
  WriteRigs(model, file("rigs.bin"));
  WriteFrames(model, file("frames.bin"));
  temporary.Commit();
}

}  // namespace sirpy
