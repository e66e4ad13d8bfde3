// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "pooled_pose.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <vector>

#include "sweepkit/geometry/impl/pnp.hpp"
#include "sweepkit/geometry/ransac.hpp"

namespace sweepkit {
namespace {

// Distances of two points may differ by so many sigmas, and by this.
constexpr double kSigmas = 3, kSlack = 0.02;  // [m]
constexpr double kMinHorizontal = 0.1;        // two points that lie nearer to a plumb line fix no turn [m]
constexpr double kThirdCoordinate = 7.815 / 5.991;  // 95 % of chi square: three degrees of freedom over two
constexpr int kRefineIterations = 5;

class PooledEstimator {
 public:
  using Model = impl::PnpPose;  // T_first_world
  static constexpr int kSampleSize = 2;
  static constexpr int kMaxModels = 1;

  PooledEstimator(std::span<const PooledMatch> matches, const PooledViews& views, const PnpOptions& options)
      : matches_(matches), views_(views), options_(options) {
    // The axes in which z points up.
    const auto upright = [](const Vec3<double>& gravity) {
      return Eigen::Quaterniond::FromTwoVectors(-gravity, Vec3<double>::UnitZ()).toRotationMatrix();
    };
    R_up_first_ = upright(views.gravity_first);
    R_up_world_ = upright(views.gravity_world);
    for (const SE3d& T : views.T_view_first) poses_.push_back({T.rotation().matrix(), T.translation()});
    for (const PooledMatch& m : matches) {
      Item& item = items_.emplace_back();
      item.p_world = R_up_world_ * m.p_world;
      const double factor = views.focal / m.sigma / options.threshold;
      item.inverse_threshold2 = factor * factor / (m.right_x ? kThirdCoordinate : 1);
      if (!m.right_x) continue;
      const double disparity = m.ray.x() - *m.right_x;  // baseline / z
      if (!(disparity > 0)) continue;
      const double depth = views.baseline / disparity;
      item.sigma = depth * m.sigma_disparity / (views.focal * disparity);
      item.p_first = R_up_first_ * (views.T_view_first[m.view].inverse() * (depth * m.ray.homogeneous()));
      item.deep = true;
    }
  }

  int size() const { return static_cast<int>(matches_.size()); }

  int solve(std::span<const int, 2> sample, std::span<Model, 1> models) const {
    const Item& a = items_[static_cast<std::size_t>(sample[0])];
    const Item& b = items_[static_cast<std::size_t>(sample[1])];
    if (!a.deep || !b.deep) return 0;
    const Vec3<double> w = b.p_world - a.p_world, f = b.p_first - a.p_first;
    const double slack = kSlack + kSigmas * std::hypot(a.sigma, b.sigma);
    if (std::abs(w.z() - f.z()) > slack) return 0;
    const double w_horizontal = w.head<2>().norm(), f_horizontal = f.head<2>().norm();
    if (std::abs(w_horizontal - f_horizontal) > slack) return 0;
    if (w_horizontal < kMinHorizontal || w_horizontal < slack || f_horizontal < kMinHorizontal) return 0;
    const double yaw = std::atan2(f.y(), f.x()) - std::atan2(w.y(), w.x());
    const Mat3<double> R = Eigen::AngleAxisd(yaw, Vec3<double>::UnitZ()).toRotationMatrix();
    // The nearer point says better where it is.
    const double share = b.sigma * b.sigma / (a.sigma * a.sigma + b.sigma * b.sigma);
    const Vec3<double> t = share * (a.p_first - R * a.p_world) + (1 - share) * (b.p_first - R * b.p_world);
    models[0] = {R_up_first_.transpose() * R * R_up_world_, R_up_first_.transpose() * t};
    return 1;
  }

  double cost(const Model& pose, int index) const {
    const auto i = static_cast<std::size_t>(index);
    const PooledMatch& m = matches_[i];
    const Model& view = poses_[m.view];
    Vec3<double> e;
    if (!impl::pnp_error(view.R * (pose.R * m.p_world + pose.t) + view.t, m.ray,
                         m.right_x ? &*m.right_x : nullptr, views_.baseline, e, nullptr))
      return 1;
    return std::min(1.0, e.squaredNorm() * items_[i].inverse_threshold2);
  }

  // Gauss and Newton with Huber's weights on T_world_first * Exp(xi).
  bool refine(Model& pose, std::span<const int> chosen) const {
    for (int k = 0; k < kRefineIterations; ++k) {
      Mat6<double> H = Mat6<double>::Identity() * 1e-6;
      Vec6<double> g = Vec6<double>::Zero();
      std::vector<Mat6<double>> adjoints;
      for (const SE3d& T : views_.T_view_first) adjoints.push_back(T.adjoint());
      for (const int c : chosen) {
        const PooledMatch& m = matches_[static_cast<std::size_t>(c)];
        const Model& view = poses_[m.view];
        Vec3<double> e;
        Eigen::Matrix<double, 3, 6> J_view;
        if (!impl::pnp_error(view.R * (pose.R * m.p_world + pose.t) + view.t, m.ray,
                             m.right_x ? &*m.right_x : nullptr, views_.baseline, e, &J_view))
          continue;
        const double whiten = views_.focal / m.sigma;
        const double norm = e.norm() * whiten;
        const double weight =
            (norm > options_.huber_width ? options_.huber_width / norm : 1) * whiten * whiten;
        const Eigen::Matrix<double, 3, 6> J = J_view * adjoints[m.view];
        H += weight * J.transpose() * J;
        g += weight * J.transpose() * e;
      }
      const Vec6<double> xi = -H.ldlt().solve(g);
      if (!xi.allFinite()) return false;
      pose = pose.moved(xi);
      if (xi.norm() < 1e-6) break;
    }
    pose.R = SO3<double>(pose.R).matrix();
    return pose.R.allFinite() && pose.t.allFinite();
  }

 private:
  struct Item {
    Vec3<double> p_world, p_first;  // in upright axes
    double sigma = 0;               // of the latter along the ray [m]
    double inverse_threshold2 = 0;
    bool deep = false;
  };

  std::span<const PooledMatch> matches_;
  const PooledViews& views_;
  const PnpOptions& options_;
  Mat3<double> R_up_first_, R_up_world_;
  std::vector<Model> poses_;
  std::vector<Item> items_;
};

}  // namespace

std::optional<PooledPose> solve_pooled_pose(std::span<const PooledMatch> matches, const PooledViews& views,
                                            const PnpOptions& options) {
  const PooledEstimator estimator(matches, views, options);
  const auto found = ransac(estimator, options.ransac);
  if (!found || static_cast<int>(found->inliers.size()) < options.min_inliers) return std::nullopt;
  return PooledPose{.T_first_world = found->model.T_world_camera().inverse(),
                    .inliers = static_cast<int>(found->inliers.size())};
}

SE3d refine_pooled_pose(std::span<const PooledMatch> matches, const PooledViews& views,
                        const SE3d& T_first_world, const PnpOptions& options) {
  std::vector<int> all(matches.size());
  std::iota(all.begin(), all.end(), 0);
  impl::PnpPose pose = impl::PnpPose::from(T_first_world.inverse());
  if (matches.empty() || !PooledEstimator(matches, views, options).refine(pose, all)) return T_first_world;
  return pose.T_world_camera().inverse();
}

}  // namespace sweepkit
