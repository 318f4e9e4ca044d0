#include "patchmatchnet/group_correlation.h"

#include <algorithm>
#include <stdexcept>
#include <string>

#include "instruction_set.h"
#include "patchmatchnet/correlation_kernels.h"

namespace sirpy {
namespace patchmatchnet {

namespace baseline {
extern const Correlate kCorrelate;
}
#ifdef SIRPY_X86
namespace avx2 {
extern const Correlate kCorrelate;
}
namespace avx512 {
extern const Correlate kCorrelate;
}
#endif

namespace {

Correlate BestCorrelate() {
  switch (BestInstructionSet()) {
#ifdef SIRPY_X86
    case InstructionSet::kAvx512:
      return avx512::kCorrelate;
    case InstructionSet::kAvx2:
      return avx2::kCorrelate;
#endif
    default:
      return baseline::kCorrelate;
  }
}

void Check(const FeatureMap& reference, const FeatureMap& source, int groups) {
  if (reference.channels != source.channels) {
    throw std::invalid_argument("GroupCorrelation: the source has " +
                                std::to_string(source.channels) + " channels, the reference " +
                                std::to_string(reference.channels));
  }
  const int channels = source.channels;
  if (groups < 1 || channels < 1 || channels % kChannelUnit != 0 ||
      channels % (int64_t{kGroupUnit} * groups) != 0) {
    throw std::invalid_argument(
        "GroupCorrelation: " + std::to_string(channels) + " channels in " + std::to_string(groups) +
        " groups. Violated constraint: a multiple of " + std::to_string(kChannelUnit) +
        " channels, of " + std::to_string(kGroupUnit) + " in a group");
  }
  if (source.height < 1 || source.width < 1 || int64_t{source.height} * source.width > INT32_MAX) {
    throw std::invalid_argument("GroupCorrelation: a source of " + std::to_string(source.width) +
                                " x " + std::to_string(source.height) +
                                " pixels. Violated constraint: 1 to 2^31 - 1 pixels");
  }
}

}  // namespace
}  // namespace patchmatchnet

std::vector<float> GroupCorrelation(const ReferenceRows& reference, const SourceFeatures& source,
                                    int groups) {
  using namespace patchmatchnet;
  const FeatureMap& rows = reference.map;
  Check(rows, source.map, groups);
  std::vector<float> found(size_t(groups) * reference.hypotheses * rows.height * rows.width);
  std::vector<float> products(size_t{kBlock} * rows.channels);
  Correlation correlation = {};
  correlation.reference = rows.features;
  correlation.source = source.map.features;
  correlation.depth = reference.depth;
  correlation.found = found.data();
  correlation.products = products.data();
  std::copy_n(source.source_from_reference.data(), 12, correlation.source_from_reference);
  correlation.behind_u = source.behind.x();
  correlation.behind_v = source.behind.y();
  correlation.height = rows.height;
  correlation.width = rows.width;
  correlation.first_row = reference.first_row;
  correlation.hypotheses = reference.hypotheses;
  correlation.channels = rows.channels;
  correlation.groups = groups;
  correlation.source_height = source.map.height;
  correlation.source_width = source.map.width;
  BestCorrelate()(correlation);
  return found;
}

}  // namespace sirpy
