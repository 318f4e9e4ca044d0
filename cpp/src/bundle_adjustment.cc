#include "bundle_adjustment.h"

#include <ceres/ceres.h>
#include <ceres/normal_prior.h>
#include <glog/logging.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <memory>
#include <stdexcept>

#include "option_bounds.h"
#include "reduced_equations.h"
#include "reprojection.h"

namespace sirpy {
namespace {

// With more of them, the reduced equations of the frames are solved as sparse ones.
constexpr int64_t kMostDenseFrames = 50;

using PoseManifold =
    ceres::ProductManifold<ceres::EigenQuaternionManifold, ceres::EuclideanManifold<3>>;
using ScaledPoseManifold =
    ceres::ProductManifold<ceres::EigenQuaternionManifold, ceres::SubsetManifold>;

using Whitening = Eigen::Matrix<double, 2, 2, Eigen::RowMajor>;

// A camera model behind pointers to functions.
struct LensFunctions {
  int parameters;
  ceres::CostFunction* (*cost)(const Eigen::Vector2d& xy, const Whitening& whitening,
                               bool in_rig);  // owned by the caller
  Eigen::Vector2d (*pixel)(const double* parameters, const Eigen::Vector2d& direction);
};

template <typename Lens>
ceres::CostFunction* Cost(const Eigen::Vector2d& xy, const Whitening& whitening, bool in_rig) {
  using Residual = Reprojection<Lens>;
  auto* residual = new Residual{xy, whitening};
  if (in_rig) {
    return new ceres::AutoDiffCostFunction<Residual, 2, 7, 7, Lens::kParameters, 3>(residual);
  }
  return new ceres::AutoDiffCostFunction<Residual, 2, 7, Lens::kParameters, 3>(residual);
}

const std::map<std::string, LensFunctions>& Lenses() {
  static const std::map<std::string, LensFunctions> lenses = [] {
    std::map<std::string, LensFunctions> all;
    ForEachLens([&all](const char* name, auto lens) {
      using Lens = decltype(lens);
      all[name] = {Lens::kParameters, &Cost<Lens>, &Lens::template Pixel<double>};
    });
    return all;
  }();
  return lenses;
}

const LensFunctions& LensOf(const AdjustedCamera& camera) { return Lenses().at(camera.lens); }

void Require(bool satisfied, const char* what) {
  if (!satisfied) throw std::invalid_argument(std::string("bundle adjustment: ") + what);
}

bool Within(int64_t index, int64_t first, int64_t end) { return index >= first && index < end; }

void Check(const AdjustedModel& model, const Observations& observations) {
  for (const AdjustedCamera& camera : model.cameras) {
    Require(Lenses().count(camera.lens) == 1, "the lens is not among those of LensNames()");
    Require(static_cast<int>(camera.parameters.size()) == LensOf(camera).parameters &&
                camera.free.size() == camera.parameters.size() &&
                camera.expected.size() == camera.parameters.size() &&
                camera.expected_sigma.size() == camera.parameters.size(),
            "a camera has not the parameters of its lens");
  }
  const auto cameras = static_cast<int64_t>(model.cameras.size());
  const auto images = static_cast<int64_t>(model.images.size());
  for (const AdjustedImage& image : model.images) {
    Require(Within(image.camera, 0, cameras) && Within(image.frame, 0, model.frames.rows()) &&
                Within(image.sensor, -1, model.sensors.rows()),
            "an image has a camera, frame or sensor that is not there");
  }
  const size_t count = observations.image.size();
  Require(count > 0 && observations.point.size() == count &&
              static_cast<size_t>(observations.xy.rows()) == count &&
              static_cast<size_t>(observations.whitening.rows()) == count,
          "the observations must be one or more, and of one number");
  Require(std::is_sorted(observations.point.begin(), observations.point.end()),
          "the observations must be sorted by point");
  for (size_t i = 0; i < count; ++i) {
    Require(Within(observations.image[i], 0, images) &&
                Within(observations.point[i], 0, model.points.rows()),
            "an observation has an image or a point that is not there");
  }
}

// All unknowns in one array: Ceres orders parameter blocks by their addresses, and only within one
// array is that order the same in every process.
class Unknowns {
 public:
  explicit Unknowns(const AdjustedModel& model) {
    for (const AdjustedCamera& camera : model.cameras) {
      cameras_.push_back(values_.size());
      values_.insert(values_.end(), camera.parameters.begin(), camera.parameters.end());
    }
    frames_ = Append(model.frames);
    sensors_ = Append(model.sensors);
    points_ = Append(model.points);
  }

  double* Camera(int64_t i) { return &values_[cameras_[i]]; }
  double* Frame(int64_t i) { return &values_[frames_ + 7 * i]; }
  double* Sensor(int64_t i) { return &values_[sensors_ + 7 * i]; }
  double* Point(int64_t i) { return &values_[points_ + 3 * i]; }

  void CopyTo(AdjustedModel& model) {
    for (size_t i = 0; i < cameras_.size(); ++i) {
      std::vector<double>& parameters = model.cameras[i].parameters;
      std::copy_n(Camera(i), parameters.size(), parameters.begin());
    }
    std::copy_n(values_.data() + frames_, model.frames.size(), model.frames.data());
    std::copy_n(values_.data() + sensors_, model.sensors.size(), model.sensors.data());
    std::copy_n(values_.data() + points_, model.points.size(), model.points.data());
  }

 private:
  template <int kColumns>
  size_t Append(const Rows<kColumns>& rows) {
    const size_t start = values_.size();
    values_.insert(values_.end(), rows.data(), rows.data() + rows.size());
    return start;
  }

  std::vector<double> values_;
  std::vector<size_t> cameras_;
  size_t frames_ = 0, sensors_ = 0, points_ = 0;
};

class Adjuster {
 public:
  Adjuster(AdjustedModel model, const Observations& observations, const Positions& positions,
           const AdjustmentOptions& options)
      : model_(std::move(model)),
        observations_(observations),
        options_(options),
        loss_(options.loss_scale),
        unknowns_(model_),
        problem_(Borrowing()) {
    AddObservations();
    AddPositions(positions);
    SetCameras();
    SetPoses(positions.image.empty());
  }

  Adjustment Run() {
    ceres::Solver::Summary summary;
    ceres::Solve(SolverOptions(), &problem_, &summary);
    Adjustment result;
    result.usable = summary.IsSolutionUsable();
    result.message = summary.message;
    unknowns_.CopyTo(model_);
    if (result.usable && options_.deviations) result.deviations = Deviations();
    result.model = std::move(model_);
    return result;
  }

 private:
  static ceres::Problem::Options Borrowing() {
    ceres::Problem::Options options;
    options.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
    options.manifold_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
    return options;
  }

  void AddObservations() {
    blocks_.reserve(observations_.image.size());
    for (size_t i = 0; i < observations_.image.size(); ++i) {
      const AdjustedImage& image = model_.images[observations_.image[i]];
      const bool in_rig = image.sensor >= 0;
      ceres::CostFunction* cost =
          LensOf(model_.cameras[image.camera])
              .cost(observations_.xy.row(i),
                    Eigen::Map<const Whitening>(observations_.whitening.data() + 4 * i), in_rig);
      std::vector<double*> of{unknowns_.Frame(image.frame)};
      if (in_rig) of.push_back(unknowns_.Sensor(image.sensor));
      of.push_back(unknowns_.Camera(image.camera));
      of.push_back(unknowns_.Point(observations_.point[i]));
      blocks_.push_back(problem_.AddResidualBlock(cost, &loss_, of));
    }
  }

  void AddPositions(const Positions& positions) {
    for (size_t i = 0; i < positions.image.size(); ++i) {
      const AdjustedImage& image = model_.images.at(positions.image[i]);
      auto* residual = new CentreResidual{positions.centre.row(i), positions.sigma.row(i)};
      if (image.sensor < 0) {
        problem_.AddResidualBlock(new ceres::AutoDiffCostFunction<CentreResidual, 3, 7>(residual),
                                  nullptr, unknowns_.Frame(image.frame));
      } else {
        problem_.AddResidualBlock(
            new ceres::AutoDiffCostFunction<CentreResidual, 3, 7, 7>(residual), nullptr,
            unknowns_.Frame(image.frame), unknowns_.Sensor(image.sensor));
      }
    }
  }

  void SetCameras() {
    for (size_t i = 0; i < model_.cameras.size(); ++i) {
      const std::vector<bool>& free = model_.cameras[i].free;
      if (problem_.HasParameterBlock(unknowns_.Camera(i))) AddExpectation(i);
      std::vector<int> fixed;
      for (size_t p = 0; p < free.size(); ++p) {
        if (!free[p]) fixed.push_back(static_cast<int>(p));
      }
      if (!problem_.HasParameterBlock(unknowns_.Camera(i)) || fixed.empty()) continue;
      if (fixed.size() == free.size()) {
        problem_.SetParameterBlockConstant(unknowns_.Camera(i));
      } else {
        lens_manifolds_.push_back(
            std::make_unique<ceres::SubsetManifold>(static_cast<int>(free.size()), fixed));
        problem_.SetManifold(unknowns_.Camera(i), lens_manifolds_.back().get());
      }
    }
  }

  void AddExpectation(size_t i) {
    const AdjustedCamera& camera = model_.cameras[i];
    const auto count = static_cast<Eigen::Index>(camera.parameters.size());
    ceres::Matrix weights = ceres::Matrix::Zero(count, count);
    for (Eigen::Index p = 0; p < count; ++p) {
      if (camera.expected_sigma[p] > 0) weights(p, p) = 1 / camera.expected_sigma[p];
    }
    if (weights.isZero()) return;
    problem_.AddResidualBlock(new ceres::NormalPrior(weights, Eigen::Map<const Eigen::VectorXd>(
                                                                  camera.expected.data(), count)),
                              nullptr, unknowns_.Camera(i));
  }

  void SetPoses(bool fix_gauge) {
    for (int64_t i = 0; i < model_.sensors.rows(); ++i) SetPose(unknowns_.Sensor(i));
    for (int64_t i = 0; i < model_.frames.rows(); ++i) SetPose(unknowns_.Frame(i));
    if (fix_gauge && model_.frames.rows() > 1) FixGauge();
  }

  void SetPose(double* pose) {
    if (problem_.HasParameterBlock(pose)) problem_.SetManifold(pose, &pose_manifold_);
  }

  // The first frame stays, and the scale with the longest coordinate of the frame farthest from it.
  void FixGauge() {
    const auto centres = model_.frames.rightCols<3>();
    Eigen::Index farthest = 0, coordinate = 0;
    const Eigen::RowVector3d first = centres.row(0);
    (centres.rowwise() - first).rowwise().squaredNorm().maxCoeff(&farthest);
    (centres.row(farthest) - first).cwiseAbs().maxCoeff(&coordinate);
    if (farthest == 0) return;  // all are at one place
    double* const anchor = unknowns_.Frame(0);
    double* const scale = unknowns_.Frame(farthest);
    if (!problem_.HasParameterBlock(anchor) || !problem_.HasParameterBlock(scale)) return;
    problem_.SetParameterBlockConstant(anchor);
    scaled_pose_manifold_ = std::make_unique<ScaledPoseManifold>(
        ceres::EigenQuaternionManifold(), ceres::SubsetManifold(3, {static_cast<int>(coordinate)}));
    problem_.SetManifold(scale, scaled_pose_manifold_.get());
  }

  ceres::Solver::Options SolverOptions() {
    ceres::Solver::Options options;
    options.linear_solver_type =
        model_.frames.rows() <= kMostDenseFrames ? ceres::DENSE_SCHUR : ceres::SPARSE_SCHUR;
    // Without BLAS, of which machines have several kinds: the same bytes on all of them.
    options.dense_linear_algebra_library_type = ceres::EIGEN;
    options.sparse_linear_algebra_library_type = ceres::EIGEN_SPARSE;
    options.linear_solver_ordering = std::make_shared<ceres::ParameterBlockOrdering>();
    std::vector<double*> blocks;
    problem_.GetParameterBlocks(&blocks);
    const double* const first_point = unknowns_.Point(0);
    for (double* block : blocks) {
      options.linear_solver_ordering->AddElementToGroup(block, block < first_point ? 1 : 0);
    }
    options.max_num_iterations = options_.iterations;
    // A step that gains a hundredth of what one standard deviation of one unknown costs is the
    // last.
    options.function_tolerance = 0.01 / problem_.NumResiduals();
    options.gradient_tolerance = 0;
    options.parameter_tolerance = 1e-12;
    options.num_threads = 1;
    options.logging_type = ceres::SILENT;
    return options;
  }

  std::vector<std::vector<double>> Deviations() {
    std::vector<std::vector<double>> deviations(model_.cameras.size());
    ReducedEquations equations(problem_);
    for (int64_t i = 0; i < model_.frames.rows(); ++i) equations.Add(unknowns_.Frame(i));
    for (int64_t i = 0; i < model_.sensors.rows(); ++i) equations.Add(unknowns_.Sensor(i));
    const int poses = equations.Size();
    for (size_t i = 0; i < model_.cameras.size(); ++i) equations.Add(unknowns_.Camera(i));
    if (equations.Size() > Adjustment::kMostUnknowns) return deviations;
    equations.Build(blocks_, unknowns_.Point(0));
    const Eigen::VectorXd of_lenses = equations.Deviations(poses);
    if (of_lenses.size() == 0 && equations.Size() > poses) return deviations;
    int next = 0;
    for (size_t i = 0; i < model_.cameras.size(); ++i) {
      const std::vector<bool>& free = model_.cameras[i].free;
      if (!problem_.HasParameterBlock(unknowns_.Camera(i))) continue;
      for (const bool one : free) deviations[i].push_back(one ? of_lenses[next++] : 0.0);
    }
    return deviations;
  }

  AdjustedModel model_;
  const Observations& observations_;
  const AdjustmentOptions options_;
  ceres::CauchyLoss loss_;
  PoseManifold pose_manifold_;
  std::unique_ptr<ScaledPoseManifold> scaled_pose_manifold_;
  std::vector<std::unique_ptr<ceres::SubsetManifold>> lens_manifolds_;
  Unknowns unknowns_;
  ceres::Problem problem_;
  std::vector<ceres::ResidualBlockId> blocks_;  // of the observations
};

}  // namespace

void AdjustmentOptions::Validate() const {
  const auto require = [](bool satisfied, const char* field, double value, const char* bound) {
    RequireOption(satisfied, "AdjustmentOptions", field, value, bound);
  };
  require(loss_scale > 0 && std::isfinite(loss_scale), "loss_scale", loss_scale, "loss_scale > 0");
  require(iterations >= 1, "iterations", iterations, "iterations >= 1");
}

std::vector<std::string> LensNames() {
  std::vector<std::string> names;
  ForEachLens([&names](const char* name, auto /*lens*/) { names.emplace_back(name); });
  return names;
}

Adjustment Adjust(AdjustedModel model, const Observations& observations, const Positions& positions,
                  const AdjustmentOptions& options) {
  options.Validate();
  Check(model, observations);
  const auto given = static_cast<Eigen::Index>(positions.image.size());
  Require(positions.centre.rows() == given && positions.sigma.rows() == given,
          "the positions must be of one number");
  // What Ceres would write to the terminal of a step that it takes back is not for the user.
  FLAGS_minloglevel = google::GLOG_FATAL;
  return Adjuster(std::move(model), observations, positions, options).Run();
}

Rows<2> Residuals(const AdjustedModel& model, const Observations& observations) {
  Check(model, observations);
  Rows<2> residuals(observations.xy.rows(), 2);
  for (Eigen::Index i = 0; i < residuals.rows(); ++i) {
    const AdjustedImage& image = model.images[observations.image[i]];
    Eigen::Vector3d point = model.points.row(observations.point[i]);
    point = Transformed<double>(model.frames.row(image.frame).data(), point);
    if (image.sensor >= 0) {
      point = Transformed<double>(model.sensors.row(image.sensor).data(), point);
    }
    const AdjustedCamera& camera = model.cameras[image.camera];
    const Eigen::Vector2d pixel =
        LensOf(camera).pixel(camera.parameters.data(), point.head<2>() / point.z());
    residuals.row(i) = observations.xy.row(i) - pixel.transpose();
  }
  return residuals;
}

}  // namespace sirpy
