// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include <pybind11/stl.h>

#include <algorithm>
#include <memory>
#include <optional>

#include "arrays.hpp"
#include "options.hpp"
#include "register.hpp"
#include "sweepkit/direction/main_direction.hpp"
#include "sweepkit/direction/manhattan_frame.hpp"
#include "sweepkit/direction/vanishing_points.hpp"
#include "sweepkit/system/main_direction_run.hpp"

namespace sweepkit::python {

namespace {

using Segments = ArrayOf<float, -1, 4>;

std::vector<LineSegment> segments_of(const Segments& rows) {
  std::vector<LineSegment> segments(rows.size());
  for (std::size_t i = 0; i < segments.size(); ++i) {
    const float* row = rows.data() + 4 * i;
    segments[i].x1 = row[0];
    segments[i].y1 = row[1];
    segments[i].x2 = row[2];
    segments[i].y2 = row[3];
  }
  return segments;
}

py::array_t<double> matrix(const Mat3<double>& m) {
  py::array_t<double> result({3, 3});
  for (int r = 0; r < 3; ++r)
    for (int c = 0; c < 3; ++c) result.mutable_at(r, c) = m(r, c);
  return result;
}

/// Labels of planes as labels of all segments, -1 where a segment is not used.
template <class Label>
py::array_t<int> spread(std::span<const InterpretationPlane> planes, std::span<const Label> labels,
                        std::size_t segments) {
  py::array_t<int> result(static_cast<py::ssize_t>(segments));
  std::fill_n(result.mutable_data(), segments, -1);
  for (std::size_t i = 0; i < planes.size(); ++i) result.mutable_data()[planes[i].segment] = labels[i];
  return result;
}

/// FrameDirection as a row of numbers without padding.
struct DirectionRow {
  std::int64_t t;
  double yaw, drift_rate, drift_sigma;
  double left_angle, left_sigma, left_confidence;
  double right_angle, right_sigma, right_confidence;
  std::int32_t left_found, right_found;
};

DirectionRow row_of(const FrameDirection& f) {
  return {f.t,
          f.yaw,
          f.drift.rate,
          f.drift.sigma,
          f.left.angle,
          f.left.sigma,
          f.left.confidence,
          f.right.angle,
          f.right.sigma,
          f.right.confidence,
          f.left.found,
          f.right.found};
}

FrameDirection frame_of(const DirectionRow& r) {
  FrameDirection f;
  f.t = r.t;
  f.yaw = r.yaw;
  f.drift = {r.drift_rate, r.drift_sigma};
  f.left = {r.left_found != 0, r.left_angle, r.left_sigma, r.left_confidence, 0};
  f.right = {r.right_found != 0, r.right_angle, r.right_sigma, r.right_confidence, 0};
  return f;
}

py::array_t<DirectionRow> rows_of(const std::vector<FrameDirection>& frames) {
  py::array_t<DirectionRow> rows(static_cast<py::ssize_t>(frames.size()));
  std::transform(frames.begin(), frames.end(), rows.mutable_data(), row_of);
  return rows;
}

using Rows = py::array_t<DirectionRow, py::array::c_style>;

std::vector<FrameDirection> frames_of(const Rows& rows, std::size_t start) {
  if (rows.ndim() != 1)
    throw py::value_error("expected frame directions of shape (n,), got " + describe(rows));
  std::vector<FrameDirection> frames;
  for (std::size_t i = start; i < static_cast<std::size_t>(rows.size()); ++i)
    frames.push_back(frame_of(rows.data()[i]));
  return frames;
}

class PyManhattan {
 public:
  explicit PyManhattan(const ManhattanOptions& options) : estimator(options) {}

  std::optional<ManhattanFrame> estimate(const Camera& camera, const Segments& rows,
                                         const std::optional<Vector3>& up) {
    const auto segments = segments_of(rows);
    std::optional<ManhattanFrame> frame;
    {
      py::gil_scoped_release release;
      interpretation_planes(camera, segments, estimator.options().segments, planes);
      frame = up ? estimator.estimate(planes, up->eigen<Vec3<double>>()) : estimator.estimate(planes);
    }
    labels = spread(std::span<const InterpretationPlane>(planes), estimator.labels(), segments.size());
    return frame;
  }

  ManhattanEstimator estimator;
  std::vector<InterpretationPlane> planes;
  py::array_t<int> labels{0};
};

}  // namespace

void register_direction(py::module_& m) {
  PYBIND11_NUMPY_DTYPE(DirectionRow, t, yaw, drift_rate, drift_sigma, left_angle, left_sigma, left_confidence,
                       right_angle, right_sigma, right_confidence, left_found, right_found);
  m.attr("frame_direction_dtype") = py::dtype::of<DirectionRow>();

  bind_options<SegmentTrustOptions>(m, "SegmentTrustOptions",
                                    "Which segments are used and how far they are trusted.");
  bind_options<VanishingPointOptions>(m, "VanishingPointOptions", "Vanishing points of one image.");
  bind_options<ManhattanOptions>(m, "ManhattanOptions", "The Manhattan frame of one image.");
  bind_options<MainDirectionOptions>(m, "MainDirectionOptions", "The main direction of a room.");

  py::class_<ManhattanFrame>(m, "ManhattanFrame",
                             "Three directions square to one another along which edges run.")
      .def_property_readonly(
          "R_camera_manhattan", [](const ManhattanFrame& f) { return matrix(f.R_camera_manhattan.matrix()); },
          "Columns are the directions in the camera's frame; the second is down.")
      .def_property_readonly(
          "covariance", [](const ManhattanFrame& f) { return matrix(f.covariance); },
          "Of the rotation vector in the camera's frame [rad^2].")
      .def_readonly("confidence", &ManhattanFrame::confidence, "Probability that the frame is right.")
      .def_readonly("support", &ManhattanFrame::support, "Weight of the segments along each direction.")
      .def_readonly("share", &ManhattanFrame::share,
                    "Weight of the segments along any of them over that of all.")
      .def_readonly("segments", &ManhattanFrame::segments, "Segments used.");

  py::class_<PyManhattan>(m, "ManhattanEstimator",
                          "Finds the Manhattan frame of one image. One for each thread.")
      .def(py::init<const ManhattanOptions&>(), py::arg("options") = ManhattanOptions{})
      .def_property_readonly("options", [](const PyManhattan& e) { return e.estimator.options(); })
      .def("estimate", &PyManhattan::estimate, py::arg("camera"), py::arg("segments"),
           py::arg("up") = py::none(),
           "The frame from segments (x1, y1, x2, y2), float32 of shape (n, 4) [px], or None. up: the up "
           "direction in the "
           "camera's frame, if it is known.")
      .def_property_readonly(
          "labels", [](const PyManhattan& e) { return e.labels; },
          "For each segment of the last call the column that it runs along, or -1.");

  m.def(
      "vanishing_points",
      [](const Camera& camera, const Segments& rows, const VanishingPointOptions& options) {
        const auto segments = segments_of(rows);
        VanishingPointFinder finder(options);
        std::vector<InterpretationPlane> planes;
        std::vector<VanishingPoint> points;
        {
          py::gil_scoped_release release;
          interpretation_planes(camera, segments, options.segments, planes);
          finder.find(planes, points);
        }
        py::array_t<double> directions({static_cast<py::ssize_t>(points.size()), py::ssize_t{3}});
        py::array_t<double> support(static_cast<py::ssize_t>(points.size()));
        for (std::size_t i = 0; i < points.size(); ++i) {
          std::copy_n(points[i].direction.data(), 3, directions.mutable_data() + 3 * i);
          support.mutable_data()[i] = points[i].support;
        }
        return py::make_tuple(
            directions, support,
            spread(std::span<const InterpretationPlane>(planes), finder.labels(), segments.size()));
      },
      py::arg("camera"), py::arg("segments"), py::arg("options") = VanishingPointOptions{},
      "Directions (n, 3) in the camera's frame by falling support, their support (n,), and for each segment "
      "its point or "
      "-1.");

  py::class_<MainDirection>(m, "MainDirection", "An accepted window.")
      .def_readonly("window_begin", &MainDirection::window_begin, "Stamp of the window's first frame [ns].")
      .def_readonly("angle", &MainDirection::angle,
                    "From the left camera's forward axis there, counter-clockwise [rad].")
      .def_readonly("confidence", &MainDirection::confidence, "Inliers over directions collected.")
      .def_readonly("run_begin", &MainDirection::run_begin, "Stamp of the run's first frame [ns].")
      .def_readonly("run_angle", &MainDirection::run_angle, "The angle there [rad].")
      .def_readonly("window_end", &MainDirection::window_end, "Stamp of the window's last frame [ns].")
      .def_readonly("frames", &MainDirection::frames, "Of the window.")
      .def_readonly("collected", &MainDirection::collected, "Frames that had a direction.")
      .def_readonly("inliers", &MainDirection::inliers, "Of these, along the answer.")
      .def_readonly("drift", &MainDirection::drift, "Of the yaw [rad/s].")
      .def_readonly("sigma", &MainDirection::sigma, "Standard error of the angle [rad].");

  py::class_<MainDirectionEstimator>(m, "MainDirectionEstimator",
                                     "Segments of stereo frames to a room's main direction.")
      .def(py::init<const StereoRig&, const MainDirectionOptions&>(), py::arg("rig"),
           py::arg("options") = MainDirectionOptions{})
      .def(
          "add",
          [](MainDirectionEstimator& e, TimeNs t, const Segments& left, const Segments& right,
             const Matrix3& R_world_body, double drift_rate, double drift_sigma) {
            const auto l = segments_of(left), r = segments_of(right);
            const SO3d R(R_world_body.eigen<Mat3<double>>());
            py::gil_scoped_release release;
            return e.add(t, l, r, R, {drift_rate, drift_sigma});
          },
          py::arg("t"), py::arg("left"), py::arg("right"), py::arg("R_world_body"),
          py::arg("drift_rate") = 0.0, py::arg("drift_sigma") = 0.0,
          "Takes the segments of a stereo frame and the body's orientation in a frame with z up; a "
          "MainDirection at the end "
          "of a window that is accepted, else None. The yaw's drift and its standard deviation [rad/s].")
      .def_property_readonly(
          "restarts", [](const MainDirectionEstimator& e) { return e.window().restarts(); },
          "Windows thrown away.");

  m.def(
      "recording_directions",
      [](const std::string& data, const MainDirectionOptions& options, double start, double duration) {
        MainDirectionRunOptions run;
        run.data_path = data;
        run.direction = options;
        run.detections = 0;
        run.recording.start = start;
        run.recording.duration = duration;
        MainDirectionRunResult result;
        {
          py::gil_scoped_release release;
          result = find_main_direction(run, {[] {
                                               py::gil_scoped_acquire acquire;
                                               if (PyErr_CheckSignals() != 0) throw py::error_already_set();
                                               return false;
                                             },
                                             {}});
        }
        return rows_of(result.frames);
      },
      py::arg("data"), py::arg("options") = MainDirectionOptions{}, py::arg("start") = 0.0,
      py::arg("duration") = 0.0,
      "What each stereo frame of a recording says: an array of frame_direction_dtype, for studies that "
      "replay it.");

  m.def(
      "first_main_direction",
      [](const Rows& rows, const MainDirectionOptions& options, std::size_t start) {
        const auto frames = frames_of(rows, start);
        py::gil_scoped_release release;
        return first_main_direction(frames, options);
      },
      py::arg("frames"), py::arg("options") = MainDirectionOptions{}, py::arg("start") = 0,
      "The first answer of a run that begins with frames[start], or None.");

  m.def(
      "window_directions",
      [](const Rows& rows, const MainDirectionOptions& options, std::size_t start, double until) {
        const auto frames = frames_of(rows, start);
        std::vector<MainDirection> windows;
        py::gil_scoped_release release;
        MainDirectionWindow window(options);
        for (const FrameDirection& frame : frames) {
          const auto answer = window.add(frame);
          if (!answer) continue;
          windows.push_back(*answer);
          if (answer->confidence >= until) break;
        }
        return windows;
      },
      py::arg("frames"), py::arg("options"), py::arg("start") = 0, py::arg("until") = 2.0,
      "All windows that are accepted, from frames[start] on, to the first of at least the confidence "
      "`until`.");
}

}  // namespace sweepkit::python
