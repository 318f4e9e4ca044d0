#include "reduced_equations.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <stdexcept>

namespace sirpy {
namespace {

using Jacobian = Eigen::Matrix<double, 2, Eigen::Dynamic, Eigen::RowMajor>;
using Mixed = Eigen::Matrix<double, Eigen::Dynamic, 3>;

// Of the scaled equations: pivots that are smaller are those of unknowns that are not determined.
constexpr double kLeastPivot = 1e-12;

// One residual block: where its unknowns without the point are, and its derivatives.
struct Row {
  std::vector<std::pair<int, Jacobian>> parts;  // first column, derivatives
  Eigen::Matrix<double, 2, 3, Eigen::RowMajor> point;
};

// Adds to the lower triangle only.
template <typename Block>
void AddLower(Eigen::MatrixXd& matrix, int row, int column, const Block& block) {
  if (row >= column) matrix.block(row, column, block.rows(), block.cols()) += block;
}

// Adds the equations of one point's residuals, the point eliminated.
void AddPoint(const std::vector<Row>& rows, Eigen::MatrixXd& matrix) {
  Eigen::Matrix3d of_point = Eigen::Matrix3d::Zero();
  for (const Row& row : rows) of_point += row.point.transpose() * row.point;
  const Eigen::LLT<Eigen::Matrix3d> point(of_point);
  if (point.info() != Eigen::Success) return;
  std::vector<std::pair<int, Mixed>> mixed;  // by first column, one for each block
  for (const Row& row : rows) {
    for (const auto& [column, part] : row.parts) {
      const Mixed product = part.transpose() * row.point;
      const auto same = std::find_if(mixed.begin(), mixed.end(),
                                     [c = column](const auto& one) { return one.first == c; });
      if (same == mixed.end()) {
        mixed.emplace_back(column, product);
      } else {
        same->second += product;
      }
      for (const auto& [other, other_part] : row.parts) {
        AddLower(matrix, column, other, part.transpose() * other_part);
      }
    }
  }
  for (const auto& [column, product] : mixed) {
    const Mixed solved = point.solve(product.transpose()).transpose();
    for (const auto& [other, other_product] : mixed) {
      AddLower(matrix, column, other, -solved * other_product.transpose());
    }
  }
}

}  // namespace

void ReducedEquations::Add(const double* block) {
  if (!problem_.HasParameterBlock(block) || problem_.IsParameterBlockConstant(block)) return;
  columns_[block] = size_;
  size_ += problem_.ParameterBlockTangentSize(block);
}

void ReducedEquations::Build(const std::vector<ceres::ResidualBlockId>& residuals,
                             const double* first_point) {
  matrix_ = Eigen::MatrixXd::Zero(size_, size_);
  std::vector<Row> rows;
  const double* last = nullptr;
  std::vector<double*> blocks;
  for (const ceres::ResidualBlockId residual : residuals) {
    problem_.GetParameterBlocksForResidualBlock(residual, &blocks);
    if (blocks.back() < first_point) throw std::invalid_argument("the last block is no point");
    if (blocks.back() != last) {
      AddPoint(rows, matrix_);
      rows.clear();
      last = blocks.back();
    }
    Row row;
    for (const double* block : blocks) {
      const auto column = columns_.find(block);
      if (column == columns_.end()) continue;
      row.parts.emplace_back(column->second,
                             Jacobian(2, problem_.ParameterBlockTangentSize(block)));
    }
    std::vector<double*> derivatives(blocks.size(), nullptr);
    auto part = row.parts.begin();
    for (size_t i = 0; i + 1 < blocks.size(); ++i) {
      if (columns_.count(blocks[i]) > 0) derivatives[i] = (part++)->second.data();
    }
    derivatives.back() = row.point.data();
    const bool whole = problem_.EvaluateResidualBlock(residual, /*apply_loss_function=*/true,
                                                      nullptr, nullptr, derivatives.data());
    if (whole) rows.push_back(std::move(row));
  }
  AddPoint(rows, matrix_);
}

Eigen::VectorXd ReducedEquations::Deviations(int first) const {
  const Eigen::VectorXd scale = matrix_.diagonal().cwiseMax(0).cwiseSqrt();
  if (size_ == 0 || !(scale.minCoeff() > 0)) return {};
  const Eigen::VectorXd inverse = scale.cwiseInverse();
  const Eigen::LLT<Eigen::MatrixXd> scaled(inverse.asDiagonal() * matrix_ * inverse.asDiagonal());
  if (scaled.info() != Eigen::Success) return {};
  const Eigen::MatrixXd& factor = scaled.matrixLLT();
  if (factor.diagonal().minCoeff() < std::sqrt(kLeastPivot)) return {};
  // The last unknowns' part of the factor is that of their own inverse covariance.
  const int count = size_ - first;
  const Eigen::MatrixXd root = factor.bottomRightCorner(count, count)
                                   .triangularView<Eigen::Lower>()
                                   .solve(Eigen::MatrixXd::Identity(count, count));
  return root.colwise().norm().transpose().cwiseProduct(inverse.tail(count));
}

}  // namespace sirpy
