// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include <pybind11/eigen.h>
#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "arrays.hpp"
#include "options.hpp"
#include "register.hpp"
#include "sweepkit/data/atlas_file.hpp"
#include "sweepkit/system/run.hpp"
#include "sweepkit/system/sweeper.hpp"

namespace sweepkit::python {

namespace {

// Keeps events until Python asks for them: threads of the system never wait for the interpreter.
class EventQueue : public EventSink {
 public:
  void on_event(const Event& event) override {
    const std::scoped_lock lock(mutex_);
    events_.push_back(event);
  }
  std::vector<Event> take() {
    const std::scoped_lock lock(mutex_);
    return std::exchange(events_, {});
  }

 private:
  std::mutex mutex_;
  std::vector<Event> events_;
};

py::dict event_dict(const Event& event) {
  py::dict d;
  d["t"] = event.t;
  d["event"] = event.name;
  for (const auto& [key, value] : event.fields)
    d[py::str(key)] = std::visit([](const auto& v) -> py::object { return py::cast(v); }, value);
  return d;
}

// A Sweeper and the events that wait.
struct SweeperWithEvents {
  EventQueue events;
  Sweeper sweeper;

  SweeperWithEvents(const auto& rig, const SweeperOptions& options) : sweeper(rig, options, &events) {}
};

// Its threads may be letting go of arrays, for which they need the interpreter, while it waits for them to
// end.
struct DeleteReleased {
  void operator()(SweeperWithEvents* p) const {
    const py::gil_scoped_release release;
    delete p;
  }
};

using Released = py::call_guard<py::gil_scoped_release>;

void register_sweeper(py::module_& m) {
  py::enum_<Frame>(m, "Frame", "Which frame a pose is asked in.")
      .value("odom", Frame::odom)
      .value("map", Frame::map);
  py::enum_<PoseBasis>(m, "PoseBasis", "What a pose rests on.")
      .value("vision", PoseBasis::vision)
      .value("odometry", PoseBasis::odometry)
      .value("guess", PoseBasis::guess);
  py::class_<BodyPose>(m, "BodyPose", "Where the body is at an instant.")
      .def_readonly("t", &BodyPose::t, "[ns]")
      .def_readonly("T_frame_body", &BodyPose::T_frame_body)
      .def_property_readonly(
          "covariance", [](const BodyPose& p) { return p.covariance; },
          "Of (rho, phi) in the body's axes, (6, 6) [m^2, rad^2].")
      .def_readonly("basis", &BodyPose::basis);
  py::class_<TrackedImage>(m, "TrackedImage", "An image and what became of it.")
      .def_readonly("t", &TrackedImage::t, "[ns]")
      .def_readonly("T_map_body", &TrackedImage::T_map_body, "As known at that moment.")
      .def_readonly("T_odom_body", &TrackedImage::T_odom_body)
      .def_property_readonly("covariance", [](const TrackedImage& i) { return i.covariance; })
      .def_readonly("basis", &TrackedImage::basis)
      .def_readonly("points", &TrackedImage::points, "Map points tracked.");
  py::class_<SweeperCounts>(m, "SweeperCounts", "Counted over a run.")
      .def_readonly("images", &SweeperCounts::images)
      .def_readonly("images_lost", &SweeperCounts::images_lost)
      .def_readonly("images_dropped", &SweeperCounts::images_dropped)
      .def_readonly("images_missing", &SweeperCounts::images_missing)
      .def_readonly("samples_dropped", &SweeperCounts::samples_dropped)
      .def_readonly("imu_samples", &SweeperCounts::imu_samples)
      .def_readonly("wheel_samples", &SweeperCounts::wheel_samples)
      .def_readonly("keyframes_made", &SweeperCounts::keyframes_made)
      .def_readonly("loops_closed", &SweeperCounts::loops_closed)
      .def_readonly("loops_rejected", &SweeperCounts::loops_rejected,
                    "Recognized, but contradicted by the rest of the map.")
      .def_readonly("maps_joined", &SweeperCounts::maps_joined);

  bind_options<MainDirectionSearchOptions>(m, "MainDirectionSearchOptions",
                                           "The search for the room's main direction.");
  bind_options<PlaceOptions>(m, "PlaceOptions", "Places known again.");
  bind_options<FloorMountingOptions>(m, "FloorMountingOptions",
                                     "The floor where a rig without wheels does not tell it.");
  bind_options<GridStageOptions>(m, "GridStageOptions", "The floor's map of a run.");
  bind_options<FloorStageOptions>(m, "FloorStageOptions",
                                  "What lies on the floor, and where there is none to drive on.");
  py::class_<ObstacleReport, std::shared_ptr<ObstacleReport>>(m, "ObstacleReport",
                                                              "Obstacles as one image showed them.")
      .def_readonly("t", &ObstacleReport::t, "[ns]")
      .def_readonly("T_odom_floor", &ObstacleReport::T_odom_floor,
                    "The frame in which boxes of `obstacles` stand.")
      .def_readonly("plane", &ObstacleReport::plane)
      .def_readonly("obstacles", &ObstacleReport::obstacles)
      .def_readonly("tracked", &ObstacleReport::tracked, "In odom.");
  bind_options<SweeperOptions>(m, "SweeperOptions", "What the whole system may be told.");
  py::class_<SweeperWithEvents>(m, "Sweeper",
                                "The whole system. Feed it from any threads, one for each kind of sample; "
                                "ask for poses from any other.")
      .def(py::init<const StereoRig&, const SweeperOptions&>(), py::arg("rig"),
           py::arg("options") = SweeperOptions{})
      .def(py::init<const Rig&, const SweeperOptions&>(), py::arg("rig"),
           py::arg("options") = SweeperOptions{})
      .def(
          "resume",
          [](SweeperWithEvents& s, const Atlas& atlas) {
            s.sweeper.resume(decode_atlas(encode_atlas(atlas.info, atlas.map)));
          },
          py::arg("atlas"), Released(),
          "Goes on with the maps of another run, before the first sample: the atlas is copied. Raises Error "
          "if "
          "it was made with another rig.")
      .def(
          "save_atlas",
          [](const SweeperWithEvents& s, const std::string& path) { s.sweeper.save_atlas(path); },
          py::arg("path"), Released(), "Writes all maps for another run, in any state.")
      .def(
          "map", [](const SweeperWithEvents& s) -> const Map& { return s.sweeper.map(); },
          py::return_value_policy::reference_internal, "The maps; in real time only after finish.")
      .def(
          "obstacles",
          [](const SweeperWithEvents& s) {
            return std::const_pointer_cast<ObstacleReport>(s.sweeper.obstacles());
          },
          Released(), "What lies on the floor, as of the newest image looked at; None without floor.enabled.")
      .def(
          "grid", [](const SweeperWithEvents& s) { return s.sweeper.grid(); }, Released(),
          "The floor as all images so far show it, an OccupancyImage; None without floor.enabled.")
      .def(
          "place_counts",
          [](const SweeperWithEvents& s) {
            const PlaceCounts& counts = s.sweeper.place_counts();
            py::dict rejected;
            for (std::size_t i = 1; i < kPlaceRejections; ++i)
              rejected[py::str(to_string(static_cast<PlaceRejection>(i)))] = counts.rejected[i];
            py::dict d;
            d["queries"] = counts.queries;
            d["candidates"] = counts.candidates;
            d["accepted"] = counts.accepted;
            d["rejected"] = rejected;
            return d;
          },
          "What became of the search for places known again, rejections by reason.")
      .def(
          "feed", [](SweeperWithEvents& s, const ImuSample& sample) { s.sweeper.feed(sample); },
          py::arg("sample"), Released())
      .def(
          "feed", [](SweeperWithEvents& s, const WheelSample& sample) { s.sweeper.feed(sample); },
          py::arg("sample"), Released())
      .def(
          "feed", [](SweeperWithEvents& s, const StereoImage& sample) { s.sweeper.feed(sample); },
          py::arg("sample"), Released(),
          "Never raises: what cannot be used is counted, told as an event and dropped.")
      .def(
          "pose_at",
          [](const SweeperWithEvents& s, TimeNs t, Frame frame) { return s.sweeper.pose_at(t, frame); },
          py::arg("t"), py::arg("frame") = Frame::odom, Released(),
          "The pose at a time [ns] from the first image to the newest sample; None outside.")
      .def(
          "finish", [](SweeperWithEvents& s) { s.sweeper.finish(); }, Released(),
          "Processes what is queued and stops all threads.")
      .def(
          "take_events",
          [](SweeperWithEvents& s) {
            py::list events;
            for (const Event& event : s.events.take()) events.append(event_dict(event));
            return events;
          },
          "What happened since the last call: dicts with t [ns], event, and the event's own fields.")
      .def(
          "counts", [](const SweeperWithEvents& s) { return s.sweeper.counts(); }, Released())
      .def(
          "images", [](const SweeperWithEvents& s, std::size_t first) { return s.sweeper.images(first); },
          py::arg("first") = 0, "Every image processed so far, from number first on.")
      .def(
          "optimized_pose",
          [](const SweeperWithEvents& s, const TrackedImage& image) {
            return s.sweeper.optimized_pose(image);
          },
          py::arg("image"), "T_map_body of the image after all corrections.");
}

// Ctrl-C in Python ends the run as in the program: what was done so far is written, then it is raised.
RunResult run_interruptibly(const RunOptions& options, const py::object& progress) {
  bool interrupted = false;
  std::optional<py::error_already_set> raised;
  const auto guarded = [&](const auto& body) {
    const py::gil_scoped_acquire acquire;
    try {
      body();
      if (PyErr_CheckSignals() != 0) throw py::error_already_set();
    } catch (py::error_already_set& error) {
      if (!raised) raised.emplace(std::move(error));
      interrupted = true;
    }
  };
  RunHooks hooks;
  hooks.stop = [&] {
    if (!interrupted) guarded([] {});
    return interrupted;
  };
  if (!progress.is_none())
    hooks.progress = [&](const RunProgress& p) {
      if (!interrupted) guarded([&] { progress(p.images, p.total, p.lost); });
    };
  RunResult result;
  {
    const py::gil_scoped_release release;
    result = run_recording(options, hooks);
  }
  if (raised) throw std::move(*raised);
  return result;
}

}  // namespace

void register_system(py::module_& m) {
  register_sweeper(m);
  bind_options<PictureOptions>(m, "PictureOptions", "Pictures of frames with their key points.");
  bind_options<RunOptions>(m, "RunOptions", "The whole system on a recording.");
  py::class_<RunResult>(m, "RunResult", "How a run went.")
      .def_readonly("initialised", &RunResult::initialised, "There was a map at some time.")
      .def_readonly("stopped", &RunResult::stopped)
      .def_readonly("counts", &RunResult::counts)
      .def_readonly("keyframes", &RunResult::keyframes)
      .def_readonly("points", &RunResult::points)
      .def_readonly("path_m", &RunResult::path_m)
      .def_readonly("seconds", &RunResult::seconds);
  m.def("run_recording", &run_interruptibly, py::arg("options"), py::arg("progress") = py::none(),
        "Runs a recording and writes all results; progress(images, total, lost) is called after each image. "
        "Ctrl-C and exceptions of progress end it, results so far written.");
}

}  // namespace sweepkit::python
