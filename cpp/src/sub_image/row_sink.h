// Rows of an image on their way: a chain of sinks (warp -> shrink -> files) passes blocks of rows
// on, so that no stage ever holds a whole image.
#pragma once

#include <cstdint>

namespace sirpy {

class RowSink {
 public:
  virtual ~RowSink() = default;

  // Takes the next `count` rows, contiguous, top to bottom; they are valid during the call only.
  virtual void Push(const uint8_t* rows, int64_t count) = 0;

  // Called once, after the last row.
  virtual void Finish() = 0;

  // No later row is needed.
  virtual bool Done() const = 0;
};

}  // namespace sirpy
