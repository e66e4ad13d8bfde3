// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/slam/loop_correction.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>

#include "sweepkit/core/error.hpp"
#include "sweepkit/solve/reprojection.hpp"

namespace sweepkit {
namespace {

constexpr double kDegree = std::numbers::pi / 180;
// A keyframe that neither points nor odometry hold stands to its parent like this [m, rad].
constexpr double kLoosePosition = 0.3;
constexpr double kLooseAngle = 0.2;

using Edge = PoseGraphEdge<SE3d>;

Mat6<double> diagonal(double position, double angle) {
  Vec6<double> variances;
  variances << Vec3<double>::Constant(position * position), Vec3<double>::Constant(angle * angle);
  return variances.asDiagonal();
}

// What the points that two keyframes share tell of the pose of each.
struct SharedView {
  int points = 0;
  Mat6<double> of_a = Mat6<double>::Zero(), of_b = Mat6<double>::Zero();  // information
};

void add_view(const RectifiedCamera& camera, const Keyframe& keyframe, const Mat3<double>& R,
              std::uint32_t index, const Vec3<double>& p_world, Mat6<double>& information) {
  const Measurement& m = keyframe.measurements[index];
  Vec3<double> e;
  Eigen::Matrix<double, 3, 6> J;
  if (!reprojection_error(camera, R, keyframe.T_camera_world.translation(), p_world, m.u, m.v, m.disparity(),
                          e, &J))
    return;
  const double w = 1 / (static_cast<double>(m.sigma) * m.sigma);
  const double w_disparity = m.stereo() ? 1 / (static_cast<double>(m.sigma_right) * m.sigma_right) : 0;
  information += J.transpose() * Vec3<double>(w, w, w_disparity).asDiagonal() * J;
}

SharedView shared_view(const Map& map, const RectifiedCamera& camera, const Keyframe& a, const Keyframe& b) {
  SharedView view;
  const Mat3<double> R_a = a.T_camera_world.rotation().matrix(), R_b = b.T_camera_world.rotation().matrix();
  for (std::uint32_t i = 0; i < a.points.size(); ++i) {
    if (!a.points[i].valid()) continue;
    const MapPoint& point = map.point(a.points[i]);
    const auto seen = std::lower_bound(point.observations.begin(), point.observations.end(), b.id,
                                       [](const Observation& o, KeyframeId id) { return o.keyframe < id; });
    if (seen == point.observations.end() || seen->keyframe != b.id) continue;
    ++view.points;
    add_view(camera, a, R_a, i, point.p_world, view.of_a);
    add_view(camera, b, R_b, seen->index, point.p_world, view.of_b);
  }
  return view;
}

std::optional<Mat6<double>> inverse_of(const Mat6<double>& information) {
  const Eigen::LLT<Mat6<double>> llt(information);
  if (llt.info() != Eigen::Success) return std::nullopt;
  Mat6<double> covariance = llt.solve(Mat6<double>::Identity());
  covariance = 0.5 * (covariance + covariance.transpose().eval());
  return covariance.allFinite() ? std::optional(covariance) : std::nullopt;
}

Mat6<double> information_of(const Mat6<double>& covariance) {
  const Mat6<double> inverse = covariance.llt().solve(Mat6<double>::Identity());
  return 0.5 * (inverse + inverse.transpose());
}

class GraphBuilder {
 public:
  GraphBuilder(const Map& map, MapId id, const RectifiedCamera& camera, const LoopCorrectionOptions& options)
      : map_(map),
        camera_(camera),
        options_(options),
        floor_(diagonal(options.position_floor, options.angle_floor * kDegree)) {
    for (std::uint32_t i = 0; i < map.keyframe_id_end(); ++i)
      if (const Keyframe* keyframe = map.find(KeyframeId{i}); keyframe && keyframe->map == id) {
        result_.keyframes.push_back(keyframe->id);
        result_.graph.add_node(keyframe->T_camera_world.inverse(), !keyframe->parent.valid());
      }
  }

  EssentialGraph operator()() {
    for (const KeyframeId id : result_.keyframes) {
      const Keyframe& keyframe = map_.keyframe(id);
      const int seen = tie_by_points(keyframe);
      const bool measured = seen == 0 && tie_by_odometry(keyframe);
      if (seen == 0 && !measured && keyframe.parent.valid())
        tie(keyframe.parent, id, diagonal(kLoosePosition, kLooseAngle));
      // The first keyframe after a blind stretch has ties of its own, and yet the stretch must hang on it.
      if (seen > 0 && keyframe.odometry && map_.keyframe(keyframe.odometry->from).blind())
        tie_by_odometry(keyframe);
    }
    return std::move(result_);
  }

 private:
  // As the two stand now. @param covariance in b's axes
  void tie(KeyframeId a, KeyframeId b, const Mat6<double>& covariance) {
    const int i = result_.node(a), j = result_.node(b);
    const auto& nodes = result_.graph.nodes;
    result_.graph.add_edge({.i = i,
                            .j = j,
                            .T_i_j = nodes[static_cast<std::size_t>(i)].T_world_node.inverse() *
                                     nodes[static_cast<std::size_t>(j)].T_world_node,
                            .information = information_of(covariance)});
  }

  int tie_by_points(const Keyframe& keyframe) {
    std::vector<Covisible> older;
    for (const Covisible& c : keyframe.covisible)
      if (c.keyframe < keyframe.id && c.points >= options_.tie_points) older.push_back(c);
    std::stable_sort(older.begin(), older.end(),
                     [](const Covisible& a, const Covisible& b) { return a.points > b.points; });
    if (older.size() > static_cast<std::size_t>(options_.ties))
      older.resize(static_cast<std::size_t>(options_.ties));
    // All these ties rest on the same measurements of this keyframe.
    const double scale = options_.noise * options_.noise * static_cast<double>(older.size());
    int ties = 0;
    for (const Covisible& c : older) {
      const Keyframe& other = map_.keyframe(c.keyframe);
      const SharedView view = shared_view(map_, camera_, other, keyframe);
      const auto of_other = inverse_of(view.of_a), of_this = inverse_of(view.of_b);
      if (!of_other || !of_this) continue;
      const Mat6<double> Ad = (keyframe.T_camera_world * other.T_camera_world.inverse()).adjoint();
      tie(other.id, keyframe.id, scale * (*of_this + Ad * *of_other * Ad.transpose()) + floor_);
      ++ties;
    }
    return ties;
  }

  bool tie_by_odometry(const Keyframe& keyframe) {
    if (!keyframe.odometry) return false;
    result_.graph.add_edge({.i = result_.node(keyframe.odometry->from),
                            .j = result_.node(keyframe.id),
                            .T_i_j = keyframe.odometry->motion.T,
                            .information = information_of(keyframe.odometry->motion.covariance + floor_)});
    return true;
  }

  const Map& map_;
  const RectifiedCamera& camera_;
  const LoopCorrectionOptions& options_;
  const Mat6<double> floor_;
  EssentialGraph result_;
};

}  // namespace

int EssentialGraph::node(KeyframeId id) const {
  const auto it = std::lower_bound(keyframes.begin(), keyframes.end(), id);
  require(it != keyframes.end() && *it == id, "EssentialGraph::node(id)", "is no keyframe of the map",
          id.value);
  return static_cast<int>(it - keyframes.begin());
}

EssentialGraph essential_graph(const Map& map, MapId id, const RectifiedCamera& camera,
                               const LoopCorrectionOptions& options) {
  return GraphBuilder(map, id, camera, options)();
}

void move_keyframes(Map& map, const std::vector<KeyframeId>& keyframes,
                    const std::vector<SE3d>& T_world_camera) {
  std::vector<int> place(map.keyframe_id_end(), -1);
  for (std::size_t k = 0; k < keyframes.size(); ++k) place[keyframes[k].value] = static_cast<int>(k);
  for (std::uint32_t i = 0; i < map.point_id_end(); ++i) {
    const MapPoint* point = map.find(PointId{i});
    if (!point) continue;
    for (const Observation& o : point->observations) {
      const int k = place[o.keyframe.value];
      if (k < 0) continue;
      map.set_position(point->id, T_world_camera[static_cast<std::size_t>(k)] *
                                      (map.keyframe(o.keyframe).T_camera_world * point->p_world));
      break;
    }
  }
  for (std::size_t k = 0; k < keyframes.size(); ++k) map.set_pose(keyframes[k], T_world_camera[k].inverse());
}

LoopCorrection correct_loop(Map& map, const RectifiedCamera& camera, const PlaceMatch& match,
                            const LoopCorrectionOptions& options) {
  const MapId into = map.keyframe(match.candidate).map;
  const SE3d T_camera_world_before = map.keyframe(match.query).T_camera_world;
  LoopCorrection result;
  result.joined = map.keyframe(match.query).map != into;
  if (result.joined)
    map.join_maps(match.query, match.candidate, match.T_camera_world.inverse() * T_camera_world_before);

  EssentialGraph essential = essential_graph(map, into, camera, options);
  const int edge = essential.graph.add_edge(
      {.i = essential.node(match.candidate),
       .j = essential.node(match.query),
       .T_i_j = match.T_query_candidate.inverse(),
       .information = information_of(options.noise * options.noise * match.covariance +
                                     diagonal(options.position_floor, options.angle_floor * kDegree)),
       .robust = !result.joined});
  const PoseGraphResult<SE3d> solved = solve_pose_graph(essential.graph, options.graph);
  result.keyframes = static_cast<int>(essential.graph.nodes.size());
  result.edges = static_cast<int>(essential.graph.edges.size());
  result.contradiction = solved.contradiction[static_cast<std::size_t>(edge)];
  result.accepted = result.joined || (solved.usable && solved.rejected.empty());
  if (!result.accepted || !solved.usable) return result;

  move_keyframes(map, essential.keyframes, solved.T_world_node);
  if (!solved.covariance.empty())
    for (std::size_t k = 0; k < essential.keyframes.size(); ++k)
      map.set_covariance(essential.keyframes[k], solved.covariance[k]);
  result.T_new_old = map.keyframe(match.query).T_camera_world.inverse() * T_camera_world_before;
  return result;
}

}  // namespace sweepkit
