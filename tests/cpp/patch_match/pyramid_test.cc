#include "patch_match/pyramid.h"

#include <gtest/gtest.h>

namespace sirpy::patch_match {
namespace {

TEST(Shrunk, AveragesBlocksAndWhatIsLeftAtTheBorder) {
  const std::vector<uint8_t> grey = {10, 20, 100,  //
                                     30, 40, 200,  //
                                     50, 60, 250};
  EXPECT_EQ(Shrunk(grey.data(), 3, 3, 2), (std::vector<uint8_t>{25, 150, 55, 250}));
  EXPECT_EQ(Shrunk(grey.data(), 3, 3, 1), grey);
  EXPECT_EQ(Shrunk(grey.data(), 3, 3, 4), (std::vector<uint8_t>{84}));  // 760 / 9, rounded once
}

TEST(PackQuads, HoldsTheFourNeighbours) {
  const std::vector<uint8_t> grey = {1, 2, 3, 4};
  std::vector<uint32_t> quads(4);
  PackQuads(grey.data(), 2, 2, quads.data());
  EXPECT_EQ(quads[0], 0x84838281u);
  EXPECT_EQ(quads[3], 0x84848484u);
}

}  // namespace
}  // namespace sirpy::patch_match
