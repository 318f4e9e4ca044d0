// Writing a binary COLMAP model that 3.8 and 4.x read: cameras.bin, images.bin, points3D.bin, and
// the rigs.bin and frames.bin of 4.x with a rig for each camera and a frame for each image, under
// their ids.
#pragma once

#include <filesystem>

#include "sub_image/sparse_model.h"

namespace sirpy {

// The tracks of the points follow from the observations of the images. The model is written to a
// temporary folder beside `folder`, which it replaces when all of it is on the disk; a process that
// is killed between the two renames leaves both models in .NAME.PROCESS.tmp. Time is linear in the
// size of the model.
// Throws OutputError when the folder cannot be written, holds anything but a model or is the
// current one; it is as it was then.
void WriteModel(const SparseModel& model, const std::filesystem::path& folder);

}  // namespace sirpy
