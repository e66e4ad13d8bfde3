// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
// Robots in simulated flats and what their sensors say: part of sweepkit.data.
#include <pybind11/eigen.h>
#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "arrays.hpp"
#include "options.hpp"
#include "register.hpp"
#include "sweepkit/data/simulate.hpp"

namespace sweepkit::python {

namespace {

using Rows3 = Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>;
/// A motion, or rows t x y z qx qy qz qw of one.
using MotionOrArray = std::variant<const PoseSpline*, ArrayOf<double, -1, 8>>;

PoseSpline through_array(const ArrayOf<double, -1, 8>& rows) {
  std::vector<StampedPose> poses;
  const double* first = rows.data();
  for (std::size_t i = 0; i < rows.size(); ++i) {
    const double* row = rows.data() + 8 * i;
    const Eigen::Quaterniond q(row[7], row[4], row[5], row[6]);
    for (int k = 0; k < 8; ++k) require(std::isfinite(row[k]), "trajectory", "must be finite", row[k]);
    require(q.norm() > 0.5 && q.norm() < 2.0, "trajectory", "must have unit quaternions qx qy qz qw",
            q.norm());
    poses.push_back({from_seconds(row[0] - first[0]), SE3d(SO3d(q), {row[1], row[2], row[3]})});
  }
  return PoseSpline::through(poses);
}

PoseSpline motion_of(const MotionOrArray& motion) {
  if (const auto* spline = std::get_if<const PoseSpline*>(&motion)) {
    require(*spline != nullptr, "motion", "must not be None", 0);
    return **spline;
  }
  return through_array(std::get<ArrayOf<double, -1, 8>>(motion));
}

template <class Samples, class Value>
Rows3 rows_of(const Samples& samples, Value value) {
  Rows3 rows(static_cast<Eigen::Index>(samples.size()), 3);
  for (std::size_t i = 0; i < samples.size(); ++i) rows.row(static_cast<Eigen::Index>(i)) = value(samples[i]);
  return rows;
}

template <class Samples>
py::array_t<std::int64_t> stamps_of(const Samples& samples) {
  py::array_t<std::int64_t> t(static_cast<py::ssize_t>(samples.size()));
  for (std::size_t i = 0; i < samples.size(); ++i) t.mutable_data()[i] = samples[i].t;
  return t;
}

py::dict imu_stream(const MotionOrArray& motion, const ImuSimulationOptions& options, TimeNs begin,
                    std::uint64_t seed) {
  const PoseSpline base = motion_of(motion);
  ImuStream stream;
  {
    py::gil_scoped_release release;
    stream = simulate_imu(base, begin, options, seed);
  }
  py::dict d;
  d["t"] = stamps_of(stream.samples);
  d["gyro"] = rows_of(stream.samples, [](const ImuSample& s) { return s.gyro; });
  d["accel"] = rows_of(stream.samples, [](const ImuSample& s) { return s.accel; });
  d["gyro_bias"] = rows_of(stream.gyro_bias, [](const Vec3<double>& v) { return v; });
  d["accel_bias"] = rows_of(stream.accel_bias, [](const Vec3<double>& v) { return v; });
  return d;
}

py::dict wheel_stream(const MotionOrArray& motion, const WheelSimulationOptions& options,
                      const std::vector<WheelEpisode>& episodes, TimeNs begin, std::uint64_t seed) {
  const PoseSpline base = motion_of(motion);
  std::vector<WheelSample> samples;
  {
    py::gil_scoped_release release;
    samples = simulate_wheels(base, begin, options, episodes, seed);
  }
  py::array_t<double> left(static_cast<py::ssize_t>(samples.size())),
      right(static_cast<py::ssize_t>(samples.size()));
  for (std::size_t i = 0; i < samples.size(); ++i) {
    left.mutable_data()[i] = samples[i].left;
    right.mutable_data()[i] = samples[i].right;
  }
  py::dict d;
  d["t"] = stamps_of(samples);
  d["left"] = left;
  d["right"] = right;
  return d;
}

py::list events_of(const std::vector<TimedEvent>& events) {
  py::list list;
  for (const TimedEvent& e : events) {
    py::dict d;
    d["kind"] = e.kind;
    d["begin"] = e.begin;
    d["end"] = e.end;
    d["note"] = e.note;
    list.append(d);
  }
  return list;
}

// Options that a scene file gives, then those of the caller.
SimulatedScene scene_with_options(const std::filesystem::path& file, SimulationOptions& options,
                                  const py::dict& values) {
  SimulatedScene scene = read_simulated_scene(file, options);
  const py::object target = py::cast(&options, py::return_value_policy::reference);
  target.attr("update")(**values);
  return scene;
}

py::dict simulate_file(const std::filesystem::path& file, const std::filesystem::path& out,
                       const py::kwargs& values) {
  SimulationOptions options;
  const SimulatedScene scene = scene_with_options(file, options, values);
  options.save_path = out.string();
  bool interrupted = false;
  SimulationHooks hooks;
  hooks.interrupted = [&] {
    const py::gil_scoped_acquire acquire;
    interrupted = interrupted || PyErr_CheckSignals() != 0;
    return interrupted;
  };
  SimulationResult result;
  {
    py::gil_scoped_release release;
    result = simulate(scene, options, hooks);
  }
  if (interrupted) throw py::error_already_set();
  py::dict d;
  d["frames"] = result.frames;
  d["duration"] = result.duration;
  d["path_m"] = result.path_m;
  d["seconds"] = result.seconds;
  return d;
}

py::tuple drive_of_file(const std::filesystem::path& file, const py::kwargs& values) {
  SimulationOptions options;
  const SimulatedScene scene = scene_with_options(file, options, values);
  std::optional<Drive> drive;
  {
    py::gil_scoped_release release;
    const FloorPlan plan(scene.scene);
    drive = make_drive(scene.scene, plan, options.robot, scene.script, scene.disturbances, options.duration,
                       static_cast<std::uint64_t>(options.seed));
  }
  return py::make_tuple(std::move(drive->base), drive->episodes, events_of(drive->events));
}

}  // namespace

void register_simulation_drive(py::module_& m) {
  py::class_<MotionState>(m, "MotionState", "A body in motion at an instant.")
      .def_readonly("T_world_body", &MotionState::T_world_body)
      .def_property_readonly(
          "velocity", [](const MotionState& s) { return s.velocity; }, "In the world [m/s].")
      .def_property_readonly(
          "acceleration", [](const MotionState& s) { return s.acceleration; }, "In the world [m/s^2].")
      .def_property_readonly(
          "angular_rate", [](const MotionState& s) { return s.angular_rate; }, "In the body [rad/s].")
      .def_property_readonly(
          "angular_acceleration", [](const MotionState& s) { return s.angular_acceleration; },
          "In the body [rad/s^2].")
      .def("of", &MotionState::of, py::arg("T_body_sensor"), "The motion of a frame fixed to this body.");
  py::class_<PoseSpline>(m, "PoseSpline",
                         "A motion with exact derivatives: a spline of degree five over poses.")
      .def(py::init<std::vector<SE3d>, double>(), py::arg("poses"), py::arg("step"),
           "Drawn towards poses one step [s] apart.")
      .def_static("through", &through_array, py::arg("rows"),
                  "Through rows t x y z qx qy qz qw (n, 8) [s, m]; times count from the first.")
      .def_property_readonly("duration", &PoseSpline::duration, "[s]")
      .def("at", &PoseSpline::at, py::arg("t"), "Pose, velocities and accelerations at a time [s].")
      .def("pose", &PoseSpline::pose, py::arg("t"));

  py::class_<WheelEpisode> episode(m, "WheelEpisode",
                                   "A time in which wheels do not roll as the robot moves.");
  py::enum_<WheelEpisode::Kind>(episode, "Kind")
      .value("slip", WheelEpisode::Kind::slip)
      .value("free", WheelEpisode::Kind::free);
  episode.def(py::init<>())
      .def_readwrite("kind", &WheelEpisode::kind)
      .def_readwrite("begin", &WheelEpisode::begin, "[s]")
      .def_readwrite("end", &WheelEpisode::end, "[s]")
      .def_readwrite("ramp", &WheelEpisode::ramp, "[s]")
      .def_readwrite("grip_left", &WheelEpisode::grip_left, "slip: moved over rolled")
      .def_readwrite("grip_right", &WheelEpisode::grip_right, "slip: moved over rolled")
      .def_readwrite("speed_left", &WheelEpisode::speed_left, "free [m/s]")
      .def_readwrite("speed_right", &WheelEpisode::speed_right, "free [m/s]");

  bind_options<RobotOptions>(m, "RobotOptions", "The robot's body and drive.");
  bind_options<ExposureOptions>(m, "ExposureOptions", "How a sensor turns light into grey levels.");
  bind_options<SimulatedCamera>(m, "SimulatedCamera", "One camera of the simulated pair.");
  bind_options<SimulatedCameras>(m, "SimulatedCameras", "The simulated pair of cameras.");
  bind_options<ImuSimulationOptions>(m, "ImuSimulationOptions", "A MEMS inertial unit.")
      .def("ideal", &ImuSimulationOptions::ideal, "The same without noise, bias, limits and resolution.");
  bind_options<WheelSimulationOptions>(m, "WheelSimulationOptions", "A differential drive with encoders.")
      .def("ideal", &WheelSimulationOptions::ideal, "The same without creep and quantisation.");
  bind_options<SimulatedSensors>(m, "SimulatedSensors", "All sensors of a simulated robot.")
      .def(
          "stereo_rig", [](const SimulatedSensors& s) { return s.rig().stereo(); }, "The pair of cameras.");
  bind_options<SimulationOptions>(m, "SimulationOptions", "How a recording is simulated.");

  m.def("imu_stream", &imu_stream, py::arg("motion"), py::arg("options") = ImuSimulationOptions{},
        py::arg("begin") = 0, py::arg("seed") = 1,
        "What an inertial unit on a moving base reads. `motion` is a PoseSpline or an array (n, 8) of rows t "
        "x y z qx qy qz "
        "qw [s, m]. Gives arrays t (n,) [ns], gyro (n, 3) [rad/s], accel (n, 3) [m/s^2], gyro_bias, "
        "accel_bias.");
  m.def("wheel_stream", &wheel_stream, py::arg("motion"), py::arg("options") = WheelSimulationOptions{},
        py::arg("episodes") = std::vector<WheelEpisode>{}, py::arg("begin") = 0, py::arg("seed") = 1,
        "What the encoders of the drive wheels count. `motion` as for imu_stream. Gives arrays t (n,) [ns], "
        "left (n,), right "
        "(n,) [ticks].");
  m.def("simulate", &simulate_file, py::arg("scene"), py::arg("out"),
        "Makes a recording from a scene file. Further arguments are fields of SimulationOptions, and come "
        "before what the "
        "file says: simulate('flat.yaml', 'out', seed=3, sensors={'cameras': {'width': 320}}).");
  m.def("plan_drive", &drive_of_file, py::arg("scene"),
        "The drive of a scene file without images: motion of the base, wheel episodes, events. Further "
        "arguments as for "
        "simulate.");
}

}  // namespace sweepkit::python
