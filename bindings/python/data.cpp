// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include <pybind11/eigen.h>
#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "arrays.hpp"
#include "options.hpp"
#include "register.hpp"
#include "sweepkit/data/evaluation.hpp"
#include "sweepkit/data/image_file.hpp"
#include "sweepkit/data/recording.hpp"
#include "sweepkit/data/trajectory.hpp"

// A class of its own, not a list of pairs.
PYBIND11_MAKE_OPAQUE(sweepkit::Trajectory)

namespace sweepkit::python {

namespace {

// An array over the pixels, which share in their owner.
py::object shared_array(const SharedGray& image) {
  if (image.empty()) return py::none();
  auto* share = new std::shared_ptr<const void>(image.owner);
  const py::capsule owner(share, [](void* p) { delete static_cast<std::shared_ptr<const void>*>(p); });
  return image_view(image.view, owner);
}

Trajectory make_trajectory(const ArrayOf<std::int64_t, -1>& t, const std::vector<SE3d>& poses) {
  require(t.size() == poses.size(), "Trajectory poses", "must be as many as the stamps", poses.size());
  Trajectory trajectory;
  for (std::size_t i = 0; i < poses.size(); ++i) {
    require(i == 0 || t.data()[i] > t.data()[i - 1], "Trajectory t", "must rise", t.data()[i]);
    trajectory.push_back({t.data()[i], poses[i]});
  }
  return trajectory;
}

py::object samples(Recording& recording) {
  std::optional<Sample> sample;
  {
    py::gil_scoped_release release;
    sample = recording.next();
  }
  if (!sample) throw py::stop_iteration();
  return std::visit([](auto& s) { return py::cast(std::move(s)); }, *sample);
}

py::dict statistics_dict(const ErrorStatistics& s) {
  py::dict d;
  d["rmse"] = s.rmse;
  d["mean"] = s.mean;
  d["median"] = s.median;
  d["max"] = s.max;
  return d;
}

void register_recordings(py::module_& m) {
  py::class_<ImuSample>(m, "ImuSample", "A reading of the inertial unit, in its own frame.")
      .def(py::init([](TimeNs t, const Vector3& gyro, const Vector3& accel) {
             return ImuSample{t, gyro.eigen<Eigen::Vector3d>(), accel.eigen<Eigen::Vector3d>()};
           }),
           py::arg("t"), py::arg("gyro"), py::arg("accel"))
      .def_readonly("t", &ImuSample::t, "[ns]")
      .def_property_readonly(
          "gyro", [](const ImuSample& s) { return s.gyro; }, "[rad/s]")
      .def_property_readonly(
          "accel", [](const ImuSample& s) { return s.accel; }, "Specific force [m/s^2].");
  py::enum_<WheelReading>(m, "WheelReading", "What the two numbers of a wheel sample are.")
      .value("ticks", WheelReading::ticks)
      .value("speeds", WheelReading::speeds);
  py::class_<WheelSample>(m, "WheelSample", "A reading of the two drive wheels.")
      .def(py::init([](TimeNs t, WheelReading reading, double left, double right) {
             return WheelSample{t, reading, left, right};
           }),
           py::arg("t"), py::arg("reading"), py::arg("left"), py::arg("right"))
      .def_readonly("t", &WheelSample::t, "[ns]")
      .def_readonly("reading", &WheelSample::reading)
      .def_readonly("left", &WheelSample::left, "[ticks] or [m/s]")
      .def_readonly("right", &WheelSample::right, "[ticks] or [m/s]");
  py::class_<StereoImage>(m, "StereoImage", "The images of both cameras at one instant.")
      .def(py::init([](TimeNs t, const std::optional<Gray>& left, const std::optional<Gray>& right) {
             const auto shared = [](const std::optional<Gray>& image) -> SharedGray {
               if (!image) return {};
               // The array lives as long as the image; letting go of it needs the interpreter.
               auto* array = new py::array(image->array);
               return {image->view(), std::shared_ptr<const void>(array, [](const void* p) {
                         const py::gil_scoped_acquire acquire;
                         delete static_cast<const py::array*>(p);
                       })};
             };
             return StereoImage{t, shared(left), shared(right)};
           }),
           py::arg("t"), py::arg("left"), py::arg("right"), "The arrays are used where they lie.")
      .def_readonly("t", &StereoImage::t, "[ns]")
      .def_property_readonly(
          "left", [](const StereoImage& s) { return shared_array(s.left); }, "Image, or None.")
      .def_property_readonly(
          "right", [](const StereoImage& s) { return shared_array(s.right); }, "Image, or None.");

  bind_options<RecordingOptions>(m, "RecordingOptions", "What to read of a recording.");
  py::class_<RecordingInfo>(m, "RecordingInfo", "What is known of a recording before it is read.")
      .def_readonly("format", &RecordingInfo::format)
      .def_readonly("path", &RecordingInfo::path)
      .def_readonly("begin", &RecordingInfo::begin, "[ns]")
      .def_readonly("end", &RecordingInfo::end, "[ns]")
      .def_readonly("images", &RecordingInfo::images)
      .def_readonly("left_missing", &RecordingInfo::left_missing)
      .def_readonly("right_missing", &RecordingInfo::right_missing)
      .def_readonly("missing_sensors", &RecordingInfo::missing_sensors)
      .def_readonly("truth", &RecordingInfo::truth);
  py::class_<Rig>(m, "Rig", "The sensors that a source has and where they sit on the body.")
      .def("stereo", &Rig::stereo, "The pair of cameras. Raises Error if one is missing or they are no pair.")
      .def_property_readonly("has_stereo", &Rig::has_stereo)
      .def_property_readonly("has_imu", [](const Rig& rig) { return rig.imu.has_value(); })
      .def_property_readonly("has_wheels", [](const Rig& rig) { return rig.wheels.has_value(); })
      .def_property_readonly(
          "T_body_base",
          [](const Rig& rig) -> std::optional<SE3d> {
            if (!rig.wheels) return std::nullopt;
            return rig.wheels->T_body_base;
          },
          "Of the wheels' base (x forward, z up, on the floor between them); None without wheels.");
  py::class_<Recording>(m, "Recording", "A recording in files; iterate over its samples.")
      .def("__iter__", [](const py::object& self) { return self; })
      .def("__next__", &samples)
      .def_property_readonly("info", [](const Recording& r) { return r.info(); })
      .def_property_readonly("rig", [](const Recording& r) { return r.rig(); })
      .def(
          "stereo_rig", [](const Recording& r) { return r.rig().stereo(); }, "The pair of cameras.");
  m.def(
      "open_recording",
      [](const std::filesystem::path& folder, const RecordingOptions& options) {
        py::gil_scoped_release release;
        return open_recording(folder, options);
      },
      py::arg("folder"), py::arg("options") = RecordingOptions{},
      "Opens a recording in the layout of EuRoC ASL or KITTI odometry.");
  m.def(
      "read_gray",
      [](const std::filesystem::path& file) {
        SharedGray image;
        {
          py::gil_scoped_release release;
          image = read_gray(file);
        }
        return shared_array(image);
      },
      py::arg("file"), "An image file as 8-bit grey.");
  m.def(
      "write_png",
      [](const std::filesystem::path& file, const Gray& image) { write_png(file, image.view()); },
      py::arg("file"), py::arg("image"));
}

void register_trajectories(py::module_& m) {
  py::class_<Trajectory>(m, "Trajectory", "Poses T_world_body in the order of their stamps.")
      .def(py::init(&make_trajectory), py::arg("t"), py::arg("poses"), "t in [ns].")
      .def_property_readonly(
          "t",
          [](const Trajectory& trajectory) {
            py::array_t<std::int64_t> t(static_cast<py::ssize_t>(trajectory.size()));
            for (std::size_t i = 0; i < trajectory.size(); ++i) t.mutable_data()[i] = trajectory[i].t;
            return t;
          },
          "Stamps (n,) [ns].")
      .def_property_readonly(
          "positions",
          [](const Trajectory& trajectory) {
            Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor> p(trajectory.size(), 3);
            for (std::size_t i = 0; i < trajectory.size(); ++i)
              p.row(i) = trajectory[i].T_world_body.translation();
            return p;
          },
          "(n, 3) [m].")
      .def_property_readonly(
          "quaternions",
          [](const Trajectory& trajectory) {
            Eigen::Matrix<double, Eigen::Dynamic, 4, Eigen::RowMajor> q(trajectory.size(), 4);
            for (std::size_t i = 0; i < trajectory.size(); ++i)
              q.row(i) = trajectory[i].T_world_body.rotation().quaternion().coeffs();
            return q;
          },
          "(n, 4), x y z w.")
      .def("__len__", [](const Trajectory& trajectory) { return trajectory.size(); })
      .def(
          "__getitem__",
          [](const Trajectory& trajectory, py::ssize_t i) {
            const auto count = static_cast<py::ssize_t>(trajectory.size());
            if (i < 0) i += count;
            if (i < 0 || i >= count) throw py::index_error();
            const StampedPose& pose = trajectory[static_cast<std::size_t>(i)];
            return std::pair(pose.t, pose.T_world_body);
          },
          py::arg("i"), "Stamp and pose.")
      .def(
          "interpolate",
          [](const Trajectory& trajectory, TimeNs t, TimeNs max_gap) {
            return interpolate(trajectory, t, max_gap);
          },
          py::arg("t"), py::arg("max_gap") = std::numeric_limits<TimeNs>::max(),
          "The pose at an instant [ns]; None outside.")
      .def(
          "path_length", [](const Trajectory& trajectory) { return path_length(trajectory); }, "[m]");
  m.def("read_trajectory", &read_trajectory, py::arg("file"), py::arg("times") = std::filesystem::path(),
        "Reads TUM, EuRoC or KITTI poses; a folder stands for the truth of the recording in it.");
  m.def("read_tum", &read_tum, py::arg("file"));
  m.def(
      "write_tum",
      [](const std::filesystem::path& file, const Trajectory& trajectory) { write_tum(file, trajectory); },
      py::arg("file"), py::arg("trajectory"));

  bind_options<EvaluationOptions>(m, "EvaluationOptions", "How trajectories are compared.");
  py::class_<Evaluation>(m, "Evaluation", "How far an estimated trajectory is from the true one.")
      .def_readonly("options", &Evaluation::options)
      .def_readonly("alignment", &Evaluation::alignment)
      .def_readonly("T_truth_estimate", &Evaluation::T_truth_estimate)
      .def_readonly("scale", &Evaluation::scale)
      .def_readonly("coverage", &Evaluation::coverage)
      .def_readonly("path_m", &Evaluation::path_m)
      .def_readonly("turned_deg", &Evaluation::turned_deg)
      .def_property_readonly("pairs", [](const Evaluation& e) { return e.pairs.size(); })
      .def_property_readonly("ape_m", [](const Evaluation& e) { return statistics_dict(e.ape_m); })
      .def_property_readonly("rotation_deg",
                             [](const Evaluation& e) { return statistics_dict(e.rotation_deg); })
      .def_property_readonly("rotation_fitted_deg",
                             [](const Evaluation& e) { return statistics_dict(e.rotation_fitted_deg); })
      .def_property_readonly("rpe_m",
                             [](const Evaluation& e) -> std::optional<py::dict> {
                               if (!e.rpe_m) return std::nullopt;
                               return statistics_dict(*e.rpe_m);
                             })
      .def_property_readonly("rpe_deg",
                             [](const Evaluation& e) -> std::optional<py::dict> {
                               if (!e.rpe_deg) return std::nullopt;
                               return statistics_dict(*e.rpe_deg);
                             })
      .def_readonly("translation_error_percent_median", &Evaluation::translation_error_percent_median)
      .def_readonly("translation_error_percent_end", &Evaluation::translation_error_percent_end)
      .def_readonly("rotation_error_percent_median", &Evaluation::rotation_error_percent_median)
      .def_readonly("rotation_error_percent_end", &Evaluation::rotation_error_percent_end)
      .def("to_json", [](const Evaluation& e) { return to_json(e); })
      .def("to_table", [](const Evaluation& e) { return to_table(e); })
      .def("to_svg", [](const Evaluation& e) { return to_svg(e); });
  m.def(
      "evaluate_trajectory",
      [](const Trajectory& truth, const Trajectory& estimate, const EvaluationOptions& options) {
        py::gil_scoped_release release;
        return evaluate_trajectory(truth, estimate, options);
      },
      py::arg("truth"), py::arg("estimate"), py::arg("options") = EvaluationOptions{},
      "Compares two trajectories.");
}

}  // namespace

void register_g2o(py::module_& m);              // pose_graph.cpp
void register_grid_evaluation(py::module_& m);  // grid_evaluation.cpp

void register_data(py::module_& m) {
  register_recordings(m);
  register_trajectories(m);
  register_simulation_world(m);
  register_simulation_drive(m);
  register_g2o(m);
  register_atlas_files(m);
  register_grid_evaluation(m);
}

}  // namespace sweepkit::python
