#include "synthetic/nearest.h"

#include <cmath>
#include <limits>

#include <gtest/gtest.h>

namespace sirpy {
namespace {

TEST(NearestDistances, EqualsTryingEveryPoint) {
  std::srand(1);
  const PointRows points = 10 * PointRows::Random(2000, 3),
                  queries = 11 * PointRows::Random(500, 3);
  for (const double limit : {0.3, 1.5, 40.0}) {
    const Eigen::VectorXd distances = NearestDistances(queries, points, limit);
    for (Eigen::Index i = 0; i < queries.rows(); ++i) {
      const double nearest = (points.rowwise() - queries.row(i)).rowwise().norm().minCoeff();
      if (nearest > limit) {
        EXPECT_TRUE(std::isinf(distances[i]));
      } else {
        EXPECT_NEAR(distances[i], nearest, 1e-12);
      }
    }
  }
}

TEST(NearestDistances, EmptyCloudIsInfinitelyFar) {
  EXPECT_TRUE(std::isinf(NearestDistances(PointRows::Zero(1, 3), PointRows(0, 3), 1)[0]));
}

TEST(NearestDistances, RefusesALimitThatIsNone) {
  const PointRows point = PointRows::Zero(1, 3);
  EXPECT_THROW(NearestDistances(point, point, 0), std::invalid_argument);
  EXPECT_THROW(NearestDistances(point, point, std::numeric_limits<double>::infinity()),
               std::invalid_argument);
}

}  // namespace
}  // namespace sirpy
