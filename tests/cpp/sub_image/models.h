// Small sparse models for tests, and their files as bytes.
#pragma once

#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>

#include "sub_image/sparse_model.h"

namespace sirpy {

// Three images of two cameras; image i sees the points i, i + 1, ... of five, at (10 j + i, j).
inline SparseModel SmallModel() {
  SparseModel model;
  model.cameras = {{4, kPinhole, 100, 80, {90, 91, 50, 40}}, {7, 2, 60, 50, {70, 30, 25, -0.1}}};
  for (uint32_t i = 0; i < 3; ++i) {
    model.images.push_back({10 + i,
                            i == 1 ? 7u : 4u,
                            "image " + std::to_string(i) + ".jpg",
                            {1, 0, 0.25, 0, 1.0 * i, 2, 3}});
    for (int32_t j = static_cast<int32_t>(i); j < 5; ++j) {
      model.xy.insert(model.xy.end(), {10.0 * j + i, 1.0 * j});
      model.point.push_back(j);
    }
    model.starts.push_back(static_cast<int64_t>(model.point.size()));
  }
  for (uint8_t j = 0; j < 5; ++j) {
    model.point_ids.push_back(1000u - j);
    model.xyz.insert(model.xyz.end(), {1.0 * j, 2.0 * j, 5});
    model.rgb.insert(model.rgb.end(), {j, 100, 200});
    model.errors.push_back(0.5 * j);
  }
  return model;
}

inline std::string ReadBytes(const std::filesystem::path& path) {
  std::ifstream stream(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>()};
}

inline void WriteBytes(const std::filesystem::path& path, const std::string& bytes) {
  std::ofstream stream(path, std::ios::binary);
  stream.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
}

}  // namespace sirpy
