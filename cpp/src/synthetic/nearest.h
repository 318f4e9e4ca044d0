// Distances from points to the nearest point of a cloud, by a hashed grid of cubic cells. Any
// frame, any unit.
#pragma once

#include <Eigen/Core>

namespace sirpy {

using PointRows = Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>;

// For each query the distance to the nearest point; infinity where it is above `limit`.
// Throws std::invalid_argument unless 0 < limit < infinity.
Eigen::VectorXd NearestDistances(const Eigen::Ref<const PointRows>& queries,
                                 const Eigen::Ref<const PointRows>& points, double limit);

}  // namespace sirpy
