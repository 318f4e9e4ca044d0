// Reading a binary COLMAP model, as 3.8 (three files) and 4.x (with rigs.bin and frames.bin) write
// it. images.bin holds cam_from_world of every image also where 4.x has rigs, so rigs and frames
// are only checked.
//
// A damaged model makes COLMAP abort, loop or allocate without end. Here every count is held
// against the size of its file, every reference against what it names, and images and tracks
// against each other.
#pragma once

#include <filesystem>

#include "sub_image/sparse_model.h"

namespace sirpy {

// Cameras, images and points in the order of the files; keypoints that see no point are left out.
// Time and memory are linear in the size of the files.
// Throws InputError, one sentence that names the file, when the model is damaged.
SparseModel ReadModel(const std::filesystem::path& folder);

}  // namespace sirpy
