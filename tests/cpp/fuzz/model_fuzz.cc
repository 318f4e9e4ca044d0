// Damaged COLMAP models: model_fuzz [--seed S] [--first CASE] [--cases COUNT]
//
// A model that the reader takes must be sound: it is written and read again.
#include "fuzz/mutate.h"

#include <array>
#include <filesystem>
#include <string>
#include <vector>

#include "sub_image/model_reader.h"
#include "sub_image/model_writer.h"
#include "sub_image/models.h"

namespace sirpy {
namespace {

namespace fs = std::filesystem;
constexpr std::array<const char*, 5> kNames = {"cameras.bin", "images.bin", "points3D.bin",
                                               "rigs.bin", "frames.bin"};
using Files = std::array<std::string, kNames.size()>;

// A model of every camera model with images that see some of its points.
SparseModel AllCameras() {
  SparseModel model;
  for (int32_t number = 0; NumCameraParameters(number) > 0; ++number) {
    const auto id = static_cast<uint32_t>(number + 1);
    const auto parameters = static_cast<size_t>(NumCameraParameters(number));
    model.cameras.push_back({id, number, 64, 48, std::vector<double>(parameters, 0.5)});
    model.images.push_back(
        {3 * id, id, std::string(number, 'n') + "ä.png", {0.5, -0.5, 0.5, 0.5, 1, 2, 3}});
    for (int32_t point = number % 3; point < 12; point += 3) {
      model.xy.insert(model.xy.end(), {0.5 * point, 48});
      model.point.push_back(point);
    }
    model.starts.push_back(static_cast<int64_t>(model.point.size()));
  }
  for (uint64_t i = 0; i < 12; ++i) {
    model.point_ids.push_back(i << (5 * i));
    model.xyz.insert(model.xyz.end(), {1.0 * i, 0, -1});
    model.rgb.insert(model.rgb.end(), {0, 0, 255});
    model.errors.push_back(-1);
  }
  return model;
}

// Makes the rig of two sensors, the second with a pose, and their frame of two images.
void UseOneRig(Files& files) {
  const auto bytes = [](auto... values) {
    std::string all;
    (all.append(reinterpret_cast<const char*>(&values), sizeof(values)), ...);
    return all;
  };
  const std::string pose = bytes(1.0, 0.0, 0.0, 0.0, 1.0, 2.0, 3.0);
  files[3] = bytes(uint64_t{1}, uint32_t{1}, uint32_t{2}, int32_t{0}, uint32_t{4}, int32_t{0},
                   uint32_t{7}, uint8_t{1}) +
             pose;
  files[4] = bytes(uint64_t{1}, uint32_t{1}, uint32_t{1}) + pose +
             bytes(uint32_t{2}, int32_t{0}, uint32_t{4}, uint64_t{10}, int32_t{0}, uint32_t{7},
                   uint64_t{11});
}

Files FilesOf(const SparseModel& model, const fs::path& folder) {
  WriteModel(model, folder);
  Files files;
  for (size_t i = 0; i < files.size(); ++i) files[i] = ReadBytes(folder / kNames[i]);
  return files;
}

class DamagedModels {
 public:
  explicit DamagedModels(const fs::path& folder)
      : folder_(folder), samples_{FilesOf(SmallModel(), folder), FilesOf(AllCameras(), folder)} {
    samples_.push_back(samples_[0]);
    UseOneRig(samples_.back());
    samples_.push_back(FilesOf({}, folder));
  }

  void operator()(fuzz::Random& random) {
    Files files = samples_[fuzz::Below(random, samples_.size())];
    const Files& others = samples_[fuzz::Below(random, samples_.size())];
    fuzz::Mutator mutated(random);
    for (uint64_t changes = 1 + fuzz::Below(random, 2); changes > 0; --changes) {
      const size_t i = fuzz::Below(random, files.size());
      files[i] = mutated(files[i], others[i]);
    }
    // New files: overwriting makes some file systems wait for the disk.
    fs::remove_all(folder_);
    fs::create_directories(folder_);
    for (size_t i = 0; i < files.size(); ++i) WriteBytes(folder_ / kNames[i], files[i]);
    const SparseModel model = ReadModel(folder_);
    WriteModel(model, folder_);
    ReadModel(folder_);
  }

 private:
  fs::path folder_;
  std::vector<Files> samples_;
};

}  // namespace
}  // namespace sirpy

int main(int argc, char** argv) {
  const sirpy::fuzz::Options options = sirpy::fuzz::ParseOptions(argc, argv);
  const std::filesystem::path folder =
      std::filesystem::temp_directory_path() / ("sirpy-model-fuzz-" + std::to_string(getpid()));
  const int status = sirpy::fuzz::Run(options, sirpy::DamagedModels(folder / "model"));
  std::filesystem::remove_all(folder);
  return status;
}
