// The normal equations of a bundle adjustment without its points, and what they say of the
// precision of other unknowns (Triggs et al., Bundle Adjustment - A Modern Synthesis, 1999).
#pragma once

#include <ceres/problem.h>

#include <Eigen/Core>
#include <unordered_map>
#include <vector>

namespace sirpy {

class ReducedEquations {
 public:
  explicit ReducedEquations(const ceres::Problem& problem) : problem_(problem) {}

  // Appends the unknowns of a parameter block; those that are constant have none.
  void Add(const double* block);

  int Size() const { return size_; }

  // From residual blocks, those of one point side by side; the parameter blocks from `first_point`
  // on are points. Memory: Size()^2 * 8 bytes, twice. Points that are not determined, such as those
  // at infinity, are left out.
  void Build(const std::vector<ceres::ResidualBlockId>& residuals, const double* first_point);

  // Standard deviations of the unknowns from `first` on; none where not all are determined.
  Eigen::VectorXd Deviations(int first) const;

 private:
  const ceres::Problem& problem_;
  std::unordered_map<const double*, int> columns_;
  int size_ = 0;
  Eigen::MatrixXd matrix_;  // lower triangle
};

}  // namespace sirpy
