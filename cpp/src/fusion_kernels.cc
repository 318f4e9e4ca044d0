// Compiled once for each instruction set with SIRPY_ISA (a namespace). No standard library here:
// nothing that the linker could share between instruction sets. The loops are plain, for the
// compiler to fill lanes with.
#include "fusion_kernels.h"

#include "depth_window.h"
#include "is_depth.h"

namespace sirpy::fusion::SIRPY_ISA {
namespace {

// How unsure a depth is, along the ray of its own view and in steps of a factor of the square root
// of 2, so that views can be put into an order: were they compared two by two, some could leave a
// point to each other in a ring. The exponent of the variance.
inline int Unsureness(double sigma) {
  const double variance = sigma * sigma;
  int64_t bits;
  __builtin_memcpy(&bits, &variance, sizeof(bits));
  return int(bits >> 52);
}

// Area of the surface that one pixel covers at a depth, where the surface's plane has that distance
// from the centre of projection.
inline double Footprint(double depth, double plane_distance, double focal_area) {
  const double facing = __builtin_fabs(plane_distance) / depth;
  return depth * depth / (focal_area * (facing > 1e-3 ? facing : 1e-3));
}

void Invert(const float* depth, int64_t count, float* inverse_depth) {
  for (int64_t i = 0; i < count; ++i) inverse_depth[i] = IsDepth(depth[i]) ? 1 / depth[i] : 0;
}

void Deviations(const float* sigma, const float* inverse_depth, int64_t count, float* deviation) {
  for (int64_t i = 0; i < count; ++i) deviation[i] = sigma[i] * inverse_depth[i] * inverse_depth[i];
}

// Of the inverse of a variance.
inline double Weight(double deviation) { return 1 / (deviation * deviation + 1e-60); }

void Begin(const Reference& reference, Run* run) {
  const double* k = reference.inverse_intrinsics;
  for (int64_t i = 0; i < run->count; ++i) {
    const double x = run->first_x + double(int32_t(i)), y = run->y;
    const double nx = run->normal[0][i], ny = run->normal[1][i], nz = run->normal[2][i];
    const double mx = k[0] * nx + k[3] * ny + k[6] * nz;
    const double my = k[1] * nx + k[4] * ny + k[7] * nz;
    const double mz = k[2] * nx + k[5] * ny + k[8] * nz;
    const double at_pixel = mx * x + my * y + mz;
    const double rho = run->inverse_depth[i] > 0 ? run->inverse_depth[i] : 1.0;
    // A surface that is seen edge on is taken to face the camera.
    const double slope = __builtin_fabs(at_pixel) < 1e-9 ? 0.0 : rho / at_pixel;
    run->plane[0][i] = mx * slope;
    run->plane[1][i] = my * slope;
    run->towards[i] = at_pixel / rho;
    run->footprint[i] = Footprint(1 / rho, run->towards[i], reference.focal_area);
    run->num_seeing[i] = run->num_close[i] = run->num_consistent[i] = run->num_through[i] =
        run->has_better[i] = 0;
    run->sum_weight[i] = Weight(run->deviation[i]);
    run->sum_inverse_depth[i] = rho * run->sum_weight[i];
  }
}

void Ask(const Source& source, const Limits& limits, Run* run) {
  double h_z[kRun], per_z[kRun], measured[kRun], agreed[kRun];
  int surer[kRun];  // steps by which the source knows its depth better
  float u[kRun], v[kRun], sampled[kRun], deviation[kRun];
  const int64_t count = run->count;
  const double* a = source.along;
  const double row_x = a[1] * run->y + a[2], row_y = a[4] * run->y + a[5],
               row_z = a[7] * run->y + a[8];
  const float x0 = float(source.x0), y0 = float(source.y0);
  for (int64_t i = 0; i < count; ++i) {
    const double x = run->first_x + double(int32_t(i)), rho = run->inverse_depth[i];
    const double z = a[6] * x + row_z + source.offset[2] * rho;
    const double inverse = 1 / z;
    h_z[i] = z;
    per_z[i] = inverse;
    // Bounds are tested in the precision that indices are computed in. Rounded before the window's
    // origin is taken off, which is exact: the window has no part in it.
    u[i] = float((a[0] * x + row_x + source.offset[0] * rho) * inverse) - x0;
    v[i] = float((a[3] * x + row_y + source.offset[1] * rho) * inverse) - y0;
  }
  const float width = float(source.width - 1), height = float(source.height - 1);
  bool any = false;
  for (int64_t i = 0; i < count; ++i) {
    const bool inside = (u[i] >= 0) & (v[i] >= 0) & (u[i] < width) & (v[i] < height);
    const float rho = InterpolatedInverseDepth(source.inverse_depth, int(source.width),
                                               inside ? u[i] : 0.f, inside ? v[i] : 0.f);
    sampled[i] = inside ? rho : 0.f;
    any |= sampled[i] > 0;
    run->num_seeing[i] += inside & (h_z[i] > 0) ? 1.0 : 0.0;
  }
  if (!any) return;
  for (int64_t i = 0; i < count; ++i) deviation[i] = 1;
  if (source.deviation) {
    for (int64_t i = 0; i < count; ++i) {
      const int64_t at = int64_t(int(v[i] + 0.5f)) * source.width + int(u[i] + 0.5f);
      deviation[i] = source.deviation[sampled[i] > 0 ? at : 0];
    }
  }
  for (int64_t i = 0; i < count; ++i) measured[i] = h_z[i] > 0 ? double(sampled[i]) : 0.0;
  for (int64_t i = 0; i < count; ++i) {
    const double x = run->first_x + double(int32_t(i)), y = run->y, rho = run->inverse_depth[i];
    // Back in the reference the source's point is p / h.z + back * difference, homogeneous.
    const double difference = measured[i] - rho * per_z[i];
    const double scale = 1 + source.back[2] * difference * h_z[i];
    const double per_scale = h_z[i] / scale;
    const double step = difference * per_scale;
    const double along_x = source.back[0] - x * source.back[2];
    const double along_y = source.back[1] - y * source.back[2];
    const double dx = step * along_x, dy = step * along_y;
    const double shift = dx * dx + dy * dy;
    // Standard deviations along the ray of the reference, and what both make of the shift.
    const double own = run->deviation[i], there = double(deviation[i]) * per_scale;
    const double moved = own * per_z[i] * per_scale;
    const double spread =
        source.deviation ? (there * there + moved * moved) * (along_x * along_x + along_y * along_y)
                         : 0.0;
    const double tolerated = limits.agreement * spread;
    // The source's point lies beside the ray: slide it along the surface onto the ray.
    const double on_ray = measured[i] * per_scale - (run->plane[0][i] * dx + run->plane[1][i] * dy);
    const double seen = (measured[i] > 0) & (scale > 0) & (on_ray > 0) & (rho > 0) ? 1.0 : 0.0;
    const double agrees =
        shift < (tolerated > limits.consistency ? tolerated : limits.consistency) ? seen : 0.0;
    const double weight = agrees > 0 ? Weight(source.deviation ? there : 1.0) : 0.0;
    run->num_consistent[i] += agrees;
    run->num_close[i] += shift < limits.consistency ? seen : 0.0;
    run->sum_inverse_depth[i] += agrees > 0 ? on_ray * weight : 0.0;
    run->sum_weight[i] += weight;
    run->num_through[i] +=
        (difference < 0) & (shift > limits.see_through) & (shift > 2 * tolerated) ? seen : 0.0;
    agreed[i] = shift < (spread > limits.yield_shift ? spread : limits.yield_shift) ? agrees : 0.0;
    const double far = measured[i] > 0 ? measured[i] : 1.0, near = rho > 0 ? rho : 1.0;
    surer[i] = source.deviation ? Unsureness(own / (near * near)) -
                                      Unsureness(double(deviation[i]) / (far * far))
                                : 0;
  }
  // A view is better that is surer or, as sure, comes first in the order; and that sees the place
  // finely enough, unless it is much surer.
  for (int64_t i = 0; i < count; ++i) {
    const double rho = run->inverse_depth[i];
    const double distance = run->towards[i] - (source.centre[0] * run->normal[0][i] +
                                               source.centre[1] * run->normal[1][i] +
                                               source.centre[2] * run->normal[2][i]);
    const double footprint = Footprint(h_z[i] / rho, distance, source.focal_area);
    const bool fine = footprint < limits.yield_footprint * run->footprint[i];
    const bool first = (surer[i] > 0) | ((surer[i] == 0) & source.comes_first);
    const double better = (surer[i] > 1) | (fine & first) ? agreed[i] : 0.0;
    run->has_better[i] = better > 0 ? 1.0 : run->has_better[i];
  }
}

}  // namespace

extern const Kernels kKernels;
const Kernels kKernels = {Invert, Deviations, Begin, Ask};

}  // namespace sirpy::fusion::SIRPY_ISA
