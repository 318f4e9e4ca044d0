#include "sub_image/shrink.h"

#include <memory>
#include <stdexcept>

#include <gtest/gtest.h>

#include "rows.h"

namespace sirpy {
namespace {

std::vector<uint8_t> Shrunk(const ImageShape& source, const std::vector<uint8_t>& pixels,
                            int64_t width, int64_t height, int64_t block = 2) {
  std::vector<uint8_t> out;
  const ImageShape target{width, height, source.channels};
  Shrink shrink(source, width, height, std::make_unique<Collect>(target, &out));
  PushAll(shrink, source, pixels, block);
  return out;
}

TEST(Shrink, ThreePixelsToTwo) {
  // The middle pixel is shared: (2 * 30 + 60) / 3, (60 + 2 * 90) / 3.
  EXPECT_EQ(Shrunk({3, 1, 1}, {30, 60, 90}, 2, 1), (std::vector<uint8_t>{40, 80}));
  EXPECT_EQ(Shrunk({1, 3, 1}, {30, 60, 90}, 1, 2), (std::vector<uint8_t>{40, 80}));
}

TEST(Shrink, WholeFactorsAreMeansOfBlocks) {
  EXPECT_EQ(Shrunk({4, 2, 1}, {1, 2, 10, 20, 3, 4, 30, 41}, 2, 1),
            (std::vector<uint8_t>{3, 25}));  // 10 / 4 rounds up, 101 / 4 down
}

TEST(Shrink, ChannelsStayApart) {
  EXPECT_EQ(Shrunk({2, 2, 3}, {0, 100, 200, 4, 100, 0, 8, 100, 0, 0, 100, 0}, 1, 1),
            (std::vector<uint8_t>{3, 100, 50}));
}

TEST(Shrink, WhiteStaysWhiteAndSameSizeCopies) {
  const ImageShape shape{37, 23, 3};
  const std::vector<uint8_t> white(shape.RowBytes() * shape.height, 255);
  EXPECT_EQ(Shrunk(shape, white, 11, 7), std::vector<uint8_t>(11 * 7 * 3, 255));
  const std::vector<uint8_t> noise = Noise(shape);
  EXPECT_EQ(Shrunk(shape, noise, 37, 23), noise);
}

TEST(Shrink, BlocksOfAnySizeGiveTheSame) {
  const ImageShape shape{37, 53, 3};
  const std::vector<uint8_t> noise = Noise(shape);
  const std::vector<uint8_t> whole = Shrunk(shape, noise, 10, 17, 53);
  for (int64_t block : {1, 5, 52}) EXPECT_EQ(Shrunk(shape, noise, 10, 17, block), whole);
}

TEST(Shrink, SixteenBitsStaySixteenBits) {
  const std::vector<uint16_t> pixels = {65535, 65533, 300, 500, 65534, 65534, 0, 1};
  const ImageShape source{2, 4, 1, 2};
  std::vector<uint8_t> bytes(reinterpret_cast<const uint8_t*>(pixels.data()),
                             reinterpret_cast<const uint8_t*>(pixels.data() + 8));
  std::vector<uint8_t> out;
  Shrink shrink(source, 1, 2, std::make_unique<Collect>(ImageShape{1, 2, 1, 2}, &out));
  PushAll(shrink, source, bytes, 3);
  ASSERT_EQ(out.size(), 4u);
  const uint16_t* means = reinterpret_cast<const uint16_t*>(out.data());
  EXPECT_EQ(means[0], 32967);  // 131868 / 4
  EXPECT_EQ(means[1], 32767);  // 131069 / 4 = 32767.25
}

TEST(Shrink, EnlargingIsRefused) {
  EXPECT_THROW(Shrunk({2, 2, 1}, {1, 2, 3, 4}, 3, 2), std::invalid_argument);
}

}  // namespace
}  // namespace sirpy
