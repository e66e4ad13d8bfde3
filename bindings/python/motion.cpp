// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
// In bulk: whole recordings in one call, as arrays. Poses are rows x y z qx qy qz qw.
#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include <cmath>
#include <limits>
#include <optional>
#include <string>
#include <vector>

#include "arrays.hpp"
#include "options.hpp"
#include "register.hpp"
#include "sweepkit/motion/gyro_bias.hpp"
#include "sweepkit/motion/imu_preintegration.hpp"
#include "sweepkit/motion/integrators.hpp"
#include "sweepkit/motion/interpolation.hpp"
#include "sweepkit/motion/navigation_filter.hpp"
#include "sweepkit/motion/slip.hpp"
#include "sweepkit/motion/standstill.hpp"
#include "sweepkit/motion/wheel_calibration.hpp"
#include "sweepkit/motion/wheel_odometry.hpp"

namespace sweepkit::python {

namespace {

using Times = ArrayOf<std::int64_t, -1>;
using Poses = ArrayOf<double, -1, 7>;
using Quaternions = ArrayOf<double, -1, 4>;
using Row7 = Eigen::Matrix<double, 7, 1>;

void require_length(std::size_t given, std::size_t expected, const char* name) {
  require(given == expected, name, "must have " + std::to_string(expected) + " rows", given);
}

/// An IMU as arrays.
struct ImuArrays {
  std::vector<ImuSample> samples;

  ImuArrays(const Times& t, const Points3& gyro, const std::optional<Points3>& accel) {
    require_length(gyro.size(), t.size(), "gyro");
    if (accel) require_length(accel->size(), t.size(), "accel");
    samples.resize(t.size());
    const auto w = gyro.as<Vec3<double>>();
    for (std::size_t i = 0; i < samples.size(); ++i) {
      samples[i].t = t.data()[i];
      samples[i].gyro = w[i];
      if (accel) samples[i].accel = accel->as<Vec3<double>>()[i];
    }
  }
};

std::vector<WheelSample> wheel_samples(const Times& t, const Points2& values, WheelReading reading) {
  require_length(values.size(), t.size(), "wheels");
  std::vector<WheelSample> samples(t.size());
  for (std::size_t i = 0; i < samples.size(); ++i)
    samples[i] = {t.data()[i], reading, values.data()[2 * i], values.data()[2 * i + 1]};
  return samples;
}

WheelReading reading_of(const std::string& name) {
  if (name == "ticks") return WheelReading::ticks;
  if (name == "speeds") return WheelReading::speeds;
  throw Error(ErrorKind::argument, "reading", "must be ticks or speeds", name);
}

Row7 row_of(const SE3d& T) {
  Row7 row;
  row << T.translation(), T.rotation().quaternion().coeffs();
  return row;
}
SE3d pose_of(const double* row) {
  return {SO3d(Eigen::Quaterniond(row[6], row[3], row[4], row[5])), Vec3<double>(row[0], row[1], row[2])};
}

/// A new array of fixed-size elements: (n, ...) by rows.
template <class Element>
class Column {
 public:
  explicit Column(std::size_t n) : values_(shape(n)) {}
  void set(std::size_t i, const Element& value) {
    Eigen::Map<Eigen::Matrix<double, Element::RowsAtCompileTime, Element::ColsAtCompileTime,
                             Element::ColsAtCompileTime == 1 ? Eigen::ColMajor : Eigen::RowMajor>>(
        data_ + i * Element::SizeAtCompileTime) = value;
  }
  py::array_t<double> array() const { return values_; }

 private:
  static std::vector<py::ssize_t> shape(std::size_t n) {
    std::vector<py::ssize_t> s{static_cast<py::ssize_t>(n), Element::RowsAtCompileTime};
    if (Element::ColsAtCompileTime != 1) s.push_back(Element::ColsAtCompileTime);
    return s;
  }
  py::array_t<double> values_;
  double* data_ = values_.mutable_data();
};

/// Calls f with the policy of that name.
template <class F>
auto with_integrator(const std::string& name, const F& f) {
  if (name == EulerIntegrator::kName) return f(EulerIntegrator());
  if (name == MidpointIntegrator::kName) return f(MidpointIntegrator());
  if (name == ClosedFormIntegrator::kName) return f(ClosedFormIntegrator());
  throw Error(ErrorKind::argument, "integrator", "must be euler, midpoint or closed_form", name);
}
template <class F>
auto with_rule(const std::string& name, const F& f) {
  if (name == MidpointRule::kName) return f(MidpointRule());
  if (name == ClosedFormRule::kName) return f(ClosedFormRule());
  if (name == CubicRule::kName) return f(CubicRule());
  throw Error(ErrorKind::argument, "rule", "must be midpoint, closed_form or cubic", name);
}

void register_structs(py::module_& m) {
  py::class_<ImuNoise>(m, "ImuNoise", "Noise of an inertial unit as continuous-time densities.")
      .def(py::init([](double gyro, double gyro_walk, double accel, double accel_walk) {
             return ImuNoise{gyro, gyro_walk, accel, accel_walk};
           }),
           py::arg("gyro_noise_density") = ImuNoise{}.gyro_noise_density,
           py::arg("gyro_random_walk") = ImuNoise{}.gyro_random_walk,
           py::arg("accel_noise_density") = ImuNoise{}.accel_noise_density,
           py::arg("accel_random_walk") = ImuNoise{}.accel_random_walk)
      .def_readwrite("gyro_noise_density", &ImuNoise::gyro_noise_density, "[rad/s/sqrt(Hz)]")
      .def_readwrite("gyro_random_walk", &ImuNoise::gyro_random_walk, "[rad/s^2/sqrt(Hz)]")
      .def_readwrite("accel_noise_density", &ImuNoise::accel_noise_density, "[m/s^2/sqrt(Hz)]")
      .def_readwrite("accel_random_walk", &ImuNoise::accel_random_walk, "[m/s^3/sqrt(Hz)]");
  py::class_<WheelGeometry>(m, "WheelGeometry", "Nominal measures of a differential drive.")
      .def(py::init([](double ticks, double radius, double track) {
             return WheelGeometry{ticks, radius, track};
           }),
           py::arg("ticks_per_revolution") = 1.0, py::arg("wheel_radius") = 1.0, py::arg("track_width") = 1.0)
      .def_readwrite("ticks_per_revolution", &WheelGeometry::ticks_per_revolution)
      .def_readwrite("wheel_radius", &WheelGeometry::wheel_radius, "[m]")
      .def_readwrite("track_width", &WheelGeometry::track_width, "[m]")
      .def("metres_per_tick", &WheelGeometry::metres_per_tick);
  py::class_<WheelParameters>(m, "WheelParameters", "What a drive measures against its nominal geometry.")
      .def(py::init([](double left, double right, double track) {
             return WheelParameters{left, right, track};
           }),
           py::arg("scale_left"), py::arg("scale_right"), py::arg("track_width"))
      .def_readwrite("scale_left", &WheelParameters::scale_left, "True over nominal radius.")
      .def_readwrite("scale_right", &WheelParameters::scale_right)
      .def_readwrite("track_width", &WheelParameters::track_width, "[m]");
  bind_options<WheelDecoderOptions>(m, "WheelDecoderOptions", "From wheel samples to distances.");
  bind_options<OdometryOptions>(m, "OdometryOptions", "Relative motion by wheels and gyro.");
  bind_options<NavigationOptions>(m, "NavigationOptions",
                                  "The filter that carries a pose by wheels and IMU.");
  bind_options<ImuPreintegrationOptions>(m, "ImuPreintegrationOptions", "Holes, ranges and thresholds.");
  bind_options<GyroBiasWindowOptions>(m, "GyroBiasWindowOptions", "Least squares over a window.");
  bind_options<GyroBiasOptions>(m, "GyroBiasOptions", "Following a gyro's bias.");
  bind_options<StandstillOptions>(m, "StandstillOptions", "When a robot counts as standing.");
  bind_options<WheelCalibrationOptions>(m, "WheelCalibrationOptions",
                                        "Radii, track and clock while driving.");
  bind_options<SlipOptions>(m, "SlipOptions", "When wheels count as slipping.");
}

void register_integration(py::module_& m) {
  m.def(
      "integrate_path",
      [](const Numbers& times, const ArrayOf<double, -1, 6>& rates, const std::string& integrator,
         const SE3d& start) {
        Column<Row7> result(times.size());
        {
          py::gil_scoped_release release;
          std::vector<SE3d> poses(times.size());
          with_integrator(integrator, [&](auto policy) {
            integrate_path<decltype(policy), double>({times.data(), times.size()}, rates.as<Vec6<double>>(),
                                                     start, poses);
          });
          for (std::size_t i = 0; i < poses.size(); ++i) result.set(i, row_of(poses[i]));
        }
        return result.array();
      },
      py::arg("times"), py::arg("rates"), py::arg("integrator") = "closed_form", py::arg("start") = SE3d(),
      "Poses (n + 1, 7) along a path of mean twists (n, 6), velocity [m/s] then angular rate [rad/s] in the "
      "body, between times (n + 1,) [s].");
  m.def(
      "integrate_covariance",
      [](const ArrayOf<double, -1, 6>& steps, const ArrayOf<double, -1, 6, 6>& noise,
         const std::string& integrator) {
        require_length(noise.size(), steps.size(), "noise");
        Column<Mat6<double>> result(steps.size());
        {
          py::gil_scoped_release release;
          with_integrator(integrator, [&](auto policy) {
            UncertainMotion<double> sum;
            using Mat6R = Eigen::Matrix<double, 6, 6, Eigen::RowMajor>;
            for (std::size_t i = 0; i < steps.size(); ++i) {
              sum = sum * integrate_step<decltype(policy)>(steps.as<Vec6<double>>()[i],
                                                           Mat6<double>(noise.as<Mat6R>()[i]));
              result.set(i, sum.covariance);
            }
          });
        }
        return result.array();
      },
      py::arg("steps"), py::arg("noise"), py::arg("integrator") = "closed_form",
      "Covariances (n, 6, 6) of the pose after each step, of the perturbation on the right (rho, phi); steps "
      "(n, 6) are twists times time, noise (n, 6, 6) their covariances.");
  m.def(
      "interpolate",
      [](const Times& t, const Points3& values, const Times& at, TimeNs offset, double max_gap) {
        require_length(values.size(), t.size(), "values");
        Column<Vec3<double>> result(at.size());
        {
          py::gil_scoped_release release;
          SampleTrack<Vec3<double>> track(offset, from_seconds(max_gap));
          for (std::size_t i = 0; i < t.size(); ++i) track.push(t.data()[i], values.as<Vec3<double>>()[i]);
          const Vec3<double> none = Vec3<double>::Constant(std::numeric_limits<double>::quiet_NaN());
          for (std::size_t i = 0; i < at.size(); ++i) result.set(i, track.at(at.data()[i]).value_or(none));
        }
        return result.array();
      },
      py::arg("t"), py::arg("values"), py::arg("at"), py::arg("offset") = 0, py::arg("max_gap") = 0.1,
      "Samples (n, 3) of a sensor with its own clock at common times [ns]: common = t + offset. Not-a-number "
      "outside the samples and in holes longer than max_gap [s].");
  m.def(
      "preintegrate",
      [](const Times& t, const Points3& gyro, const Points3& accel, const Times& begin, const Times& end,
         const Vector3& gyro_bias, const Vector3& accel_bias, const ImuNoise& noise, const std::string& rule,
         const ImuPreintegrationOptions& options) {
        require_length(end.size(), begin.size(), "end");
        const ImuArrays imu(t, gyro, accel);
        const ImuBias bias{gyro_bias.eigen<Vec3<double>>(), accel_bias.eigen<Vec3<double>>()};
        const std::size_t n = begin.size();
        Column<Eigen::Vector4d> R(n);
        Column<Vec3<double>> v(n), p(n);
        Column<Mat3<double>> R_gyro(n), v_gyro(n), v_accel(n), p_gyro(n), p_accel(n);
        Column<Eigen::Matrix<double, 9, 9>> covariance(n);
        Column<Eigen::Vector2d> holes(n);
        {
          py::gil_scoped_release release;
          const auto& s = imu.samples;
          with_rule(rule, [&](auto policy) {
            const auto before = [](const ImuSample& a, TimeNs b) { return a.t < b; };
            for (std::size_t i = 0; i < n; ++i) {
              // Two samples on either side for the cubic rule.
              auto from = std::lower_bound(s.begin(), s.end(), begin.data()[i], before);
              auto to = std::lower_bound(from, s.end(), end.data()[i], before);
              from -= std::min<std::ptrdiff_t>(3, from - s.begin());
              to += std::min<std::ptrdiff_t>(3, s.end() - to);
              const auto d = preintegrate<decltype(policy)>({from, to}, begin.data()[i], end.data()[i], bias,
                                                            noise, options);
              require(d.has_value(), "preintegrate begin", "needs a sample, and a later end; at row", i);
              R.set(i, d->R.quaternion().coeffs());
              v.set(i, d->v);
              p.set(i, d->p);
              R_gyro.set(i, d->R_gyro);
              v_gyro.set(i, d->v_gyro);
              v_accel.set(i, d->v_accel);
              p_gyro.set(i, d->p_gyro);
              p_accel.set(i, d->p_accel);
              covariance.set(i, d->covariance);
              holes.set(i, {d->uncovered, d->saturated});
            }
          });
        }
        py::dict result;
        result["R"] = R.array();
        result["v"] = v.array();
        result["p"] = p.array();
        result["R_gyro"] = R_gyro.array();
        result["v_gyro"] = v_gyro.array();
        result["v_accel"] = v_accel.array();
        result["p_gyro"] = p_gyro.array();
        result["p_accel"] = p_accel.array();
        result["covariance"] = covariance.array();
        result["uncovered_saturated"] = holes.array();
        return result;
      },
      py::arg("t"), py::arg("gyro"), py::arg("accel"), py::arg("begin"), py::arg("end"),
      py::arg("gyro_bias") = Vec3<double>(0, 0, 0), py::arg("accel_bias") = Vec3<double>(0, 0, 0),
      py::arg("noise") = ImuNoise{}, py::arg("rule") = "closed_form",
      py::arg("options") = ImuPreintegrationOptions{},
      "Integrates an IMU over many intervals [begin, end) [ns]: a dict of arrays with one row for each, "
      "rotations as x y z w, with derivatives with respect to the bias and covariances of (phi, v, p).");
}

void register_wheels(py::module_& m) {
  m.def(
      "wheel_steps",
      [](const Times& t, const Points2& wheels, const WheelGeometry& geometry, const std::string& reading,
         const WheelDecoderOptions& options) {
        WheelDecoder decoder(geometry, options);
        std::vector<WheelStep> steps;
        for (const auto& s : wheel_samples(t, wheels, reading_of(reading)))
          if (const auto step = decoder.push(s)) steps.push_back(*step);
        Column<Eigen::Vector2d> rolled(steps.size());
        py::array_t<std::int64_t> span({static_cast<py::ssize_t>(steps.size()), py::ssize_t{2}});
        py::array_t<bool> measured(static_cast<py::ssize_t>(steps.size()));
        for (std::size_t i = 0; i < steps.size(); ++i) {
          rolled.set(i, {steps[i].left, steps[i].right});
          span.mutable_data()[2 * i] = steps[i].begin;
          span.mutable_data()[2 * i + 1] = steps[i].end;
          measured.mutable_data()[i] = steps[i].measured;
        }
        py::dict result;
        result["span"] = span;
        result["rolled"] = rolled.array();
        result["measured"] = measured;
        result["refused"] = decoder.refused();
        result["wraps"] = decoder.wraps();
        result["resets"] = decoder.resets();
        return result;
      },
      py::arg("t"), py::arg("wheels"), py::arg("geometry"), py::arg("reading") = "ticks",
      py::arg("options") = WheelDecoderOptions{},
      "Distances (n, 2) left and right [m] between wheel samples, their spans (n, 2) [ns] and whether they "
      "were measured.");
  m.def(
      "odometry",
      [](const Times& at, const std::optional<Times>& wheel_t, const std::optional<Points2>& wheels,
         const WheelGeometry& geometry, const std::string& reading, const std::optional<Times>& imu_t,
         const std::optional<Points3>& gyro, const std::optional<Points3>& gyro_bias,
         const std::optional<ArrayOf<double, -1, 3>>& parameters, const SE3d& T_body_base,
         const ImuNoise& noise, const std::string& integrator, const OdometryOptions& options, TimeNs offset,
         const std::optional<ArrayOf<std::int64_t, -1, 2>>& distrusted) {
        const std::size_t n = at.size();
        require(n >= 1, "odometry at", "must have a time", n);
        std::vector<ImuSample> imu;
        if (imu_t && gyro) imu = ImuArrays(*imu_t, *gyro, std::nullopt).samples;
        std::vector<WheelSample> ticks;
        if (wheel_t && wheels) ticks = wheel_samples(*wheel_t, *wheels, reading_of(reading));
        const auto one_or_all = [&](const auto& array, const char* name) {
          if (array && array->size() != 1) require_length(array->size(), n, name);
        };
        one_or_all(gyro_bias, "gyro_bias");
        one_or_all(parameters, "parameters");
        Column<Row7> poses(n);
        Column<Mat6<double>> covariances(n - 1);
        Column<Eigen::Matrix<double, 6, 3>> d_bias(n - 1), d_wheels(n - 1);
        Column<Eigen::Vector2d> without(n - 1);
        {
          py::gil_scoped_release release;
          with_integrator(integrator, [&](auto policy) {
            BasicOdometryIntegrator<decltype(policy)> odometry(geometry, T_body_base, noise, options, offset);
            for (std::size_t i = 0; distrusted && i < distrusted->size(); ++i)
              odometry.distrust_wheels(distrusted->data()[2 * i], distrusted->data()[2 * i + 1]);
            SE3d pose;
            poses.set(0, row_of(pose));
            std::size_t g = 0, w = 0;
            for (std::size_t i = 0; i + 1 < n; ++i) {
              const TimeNs begin = at.data()[i], end = at.data()[i + 1];
              // A little beyond, so that the end lies between samples where it can.
              const TimeNs until = end + kNsPerSecond / 2;
              while (g < imu.size() && imu[g].t <= until) odometry.add(imu[g++]);
              while (w < ticks.size() && ticks[w].t <= until) odometry.add(ticks[w++]);
              if (gyro_bias)
                odometry.set_gyro_bias(
                    gyro_bias->template as<Vec3<double>>()[gyro_bias->size() == 1 ? 0 : i]);
              if (parameters) {
                const auto p = parameters->template as<Vec3<double>>()[parameters->size() == 1 ? 0 : i];
                odometry.set_wheels({p[0], p[1], p[2]});
              }
              const OdometryMotion motion = odometry.between(begin, end);
              pose = pose * motion.motion.T;
              poses.set(i + 1, row_of(pose));
              covariances.set(i, motion.motion.covariance);
              d_bias.set(i, motion.d_gyro_bias);
              d_wheels.set(i, motion.d_wheels);
              without.set(i, {motion.without_gyro, motion.without_wheels});
              odometry.forget_before(begin);
            }
          });
        }
        py::dict result;
        result["poses"] = poses.array();
        result["covariance"] = covariances.array();
        result["d_gyro_bias"] = d_bias.array();
        result["d_wheels"] = d_wheels.array();
        result["without_gyro_wheels"] = without.array();
        return result;
      },
      py::arg("at"), py::arg("wheel_t") = py::none(), py::arg("wheels") = py::none(),
      py::arg("geometry") = WheelGeometry{}, py::arg("reading") = "ticks", py::arg("imu_t") = py::none(),
      py::arg("gyro") = py::none(), py::arg("gyro_bias") = py::none(), py::arg("parameters") = py::none(),
      py::arg("T_body_base") = SE3d(), py::arg("noise") = ImuNoise{}, py::arg("integrator") = "closed_form",
      py::arg("options") = OdometryOptions{}, py::arg("offset") = 0, py::arg("distrusted") = py::none(),
      "Dead reckoning at times `at` (n,) [ns]: poses (n, 7) of the body from the first on, and for each of "
      "the "
      "n - 1 motions its covariance, its derivatives with respect to gyro bias and (scale_left, scale_right, "
      "track), and the time without gyro and without wheels [s]. gyro_bias and parameters have one row, or "
      "one for each time. Without gyro the wheels turn the base. offset [ns] is added to the wheels' "
      "stamps.");
}

void register_bias(py::module_& m) {
  m.def(
      "solve_gyro_bias",
      [](const Times& t, const Points3& gyro, const Times& attitude_t, const Quaternions& attitudes,
         const Vector3& start, const ImuNoise& noise, const GyroBiasWindowOptions& options) {
        require_length(attitudes.size(), attitude_t.size(), "attitudes");
        const ImuArrays imu(t, gyro, std::nullopt);
        std::optional<GyroBiasEstimate> estimate;
        {
          py::gil_scoped_release release;
          std::vector<TurnPair> pairs;
          const auto& s = imu.samples;
          const auto before = [](const ImuSample& a, TimeNs b) { return a.t < b; };
          for (std::size_t i = 0; i + 1 < attitude_t.size(); ++i) {
            const TimeNs a = attitude_t.data()[i], b = attitude_t.data()[i + 1];
            auto from = std::lower_bound(s.begin(), s.end(), a, before);
            auto to = std::lower_bound(from, s.end(), b, before);
            if (from != s.begin()) --from;
            if (to != s.end()) ++to;
            const auto R = [&](std::size_t k) {
              const double* q = attitudes.data() + 4 * k;
              return SO3d(Eigen::Quaterniond(q[3], q[0], q[1], q[2]));
            };
            const auto g = integrate_gyro({from, to}, a, b, start.eigen<Vec3<double>>(), noise);
            if (g) pairs.push_back({R(i).inverse() * R(i + 1), *g});
          }
          estimate = solve_gyro_bias(pairs, options);
        }
        return estimate ? std::optional(std::pair(estimate->bias, estimate->covariance)) : std::nullopt;
      },
      py::arg("t"), py::arg("gyro"), py::arg("attitude_t"), py::arg("attitudes"),
      py::arg("start") = Vec3<double>(0, 0, 0), py::arg("noise") = ImuNoise{},
      py::arg("options") = GyroBiasWindowOptions{},
      "One window: bias (3,) [rad/s] and covariance (3, 3) from attitudes of the body (m, 4), x y z w; None "
      "without a pair.");
  m.def(
      "follow_gyro_bias",
      [](const Times& t, const Points3& gyro, const Times& attitude_t, const Quaternions& attitudes,
         const std::optional<ArrayOf<std::int64_t, -1>>& standing, const ImuNoise& noise,
         const GyroBiasOptions& options, const Vector3& start) {
        require_length(attitudes.size(), attitude_t.size(), "attitudes");
        if (standing) require_length(standing->size(), t.size(), "standing");
        const ImuArrays imu(t, gyro, std::nullopt);
        const std::size_t n = attitude_t.size();
        Column<Vec3<double>> bias(n), target(n), sigma(n);
        {
          py::gil_scoped_release release;
          const Vec3<double> none = Vec3<double>::Constant(std::numeric_limits<double>::quiet_NaN());
          GyroBiasEstimator estimator(noise, options, start.eigen<Vec3<double>>());
          std::size_t k = 0;
          for (std::size_t i = 0; i < n; ++i) {
            const TimeNs at = attitude_t.data()[i];
            // One sample beyond, so that the attitude lies between samples.
            for (bool beyond = false; k < imu.samples.size() && !beyond; ++k) {
              beyond = imu.samples[k].t > at;
              if (standing) estimator.set_standing(standing->data()[k] != 0);
              estimator.add(imu.samples[k]);
            }
            const double* q = attitudes.data() + 4 * i;
            estimator.add_attitude(at, SO3d(Eigen::Quaterniond(q[3], q[0], q[1], q[2])));
            bias.set(i, estimator.bias());
            target.set(i, estimator.target() ? estimator.target()->bias : none);
            sigma.set(i, estimator.target()
                             ? Vec3<double>(estimator.target()->covariance.diagonal().cwiseSqrt())
                             : none);
          }
        }
        py::dict result;
        result["bias"] = bias.array();
        result["target"] = target.array();
        result["sigma"] = sigma.array();
        return result;
      },
      py::arg("t"), py::arg("gyro"), py::arg("attitude_t"), py::arg("attitudes"),
      py::arg("standing") = py::none(), py::arg("noise") = ImuNoise{}, py::arg("options") = GyroBiasOptions{},
      py::arg("start") = Vec3<double>(0, 0, 0),
      "Follows the bias through a recording: at each attitude (m, 4), x y z w, the bias after limit and low "
      "pass, the estimate it goes towards and that one's standard deviation [rad/s], not-a-number before the "
      "first. standing (n,) tells for each sample whether the body stands.");
  m.def(
      "standstill_bias",
      [](const Times& t, const Points3& gyro, const ImuNoise& noise) {
        StandstillBias stand(noise);
        for (const auto& s : ImuArrays(t, gyro, std::nullopt).samples) stand.add(s);
        const auto e = stand.estimate();
        return e ? std::optional(std::pair(e->bias, Vec3<double>(e->covariance.diagonal().cwiseSqrt())))
                 : std::nullopt;
      },
      py::arg("t"), py::arg("gyro"), py::arg("noise") = ImuNoise{},
      "Bias and its standard deviation [rad/s] from samples at rest; None for fewer than two.");
}

/// Feeds wheels and IMU in the order of their stamps, of equal ones the wheels first.
template <class OnWheels, class OnImu>
void merge(const std::vector<WheelSample>& wheels, const std::vector<ImuSample>& imu,
           const OnWheels& on_wheels, const OnImu& on_imu) {
  std::size_t w = 0;
  for (std::size_t i = 0; i < imu.size(); ++i) {
    while (w < wheels.size() && wheels[w].t <= imu[i].t) on_wheels(w++);
    on_imu(i);
  }
  while (w < wheels.size()) on_wheels(w++);
}

void register_watching(py::module_& m) {
  m.def(
      "detect_standstill",
      [](const std::optional<Times>& imu_t, const std::optional<Points3>& gyro,
         const std::optional<Points3>& accel, const std::optional<Times>& wheel_t,
         const std::optional<Points2>& wheels, const WheelGeometry& geometry, const std::string& reading,
         const ImuNoise& noise, double imu_rate, const StandstillOptions& options) {
        std::vector<ImuSample> imu;
        if (imu_t && gyro && accel) imu = ImuArrays(*imu_t, *gyro, accel).samples;
        std::vector<WheelSample> ticks;
        if (wheel_t && wheels) ticks = wheel_samples(*wheel_t, *wheels, reading_of(reading));
        const bool at_imu = !imu.empty();
        py::array_t<bool> standing(static_cast<py::ssize_t>(at_imu ? imu.size() : ticks.size()));
        bool* out = standing.mutable_data();
        {
          py::gil_scoped_release release;
          StandstillDetector detector(noise, imu_rate, geometry, options);
          merge(
              ticks, imu,
              [&](std::size_t w) {
                detector.add(ticks[w]);
                if (!at_imu) out[w] = detector.standing();
              },
              [&](std::size_t i) {
                detector.add(imu[i]);
                out[i] = detector.standing();
              });
        }
        return standing;
      },
      py::arg("imu_t") = py::none(), py::arg("gyro") = py::none(), py::arg("accel") = py::none(),
      py::arg("wheel_t") = py::none(), py::arg("wheels") = py::none(), py::arg("geometry") = WheelGeometry{},
      py::arg("reading") = "ticks", py::arg("noise") = ImuNoise{}, py::arg("imu_rate") = 200.0,
      py::arg("options") = StandstillOptions{},
      "For each sample of the IMU, without one of the wheels, whether the robot stands.");

  const auto motions_of = [](const Times& vision_t, const Poses& poses, double sigma_m, double sigma_rad) {
    require_length(poses.size(), vision_t.size(), "poses");
    std::vector<std::pair<std::pair<TimeNs, TimeNs>, UncertainMotion<double>>> motions;
    for (std::size_t i = 0; i + 1 < vision_t.size(); ++i) {
      UncertainMotion<double> motion{
          pose_of(poses.data() + 7 * i).inverse() * pose_of(poses.data() + 7 * (i + 1)), {}};
      motion.covariance.setZero();
      motion.covariance.diagonal().head<3>().setConstant(sigma_m * sigma_m);
      motion.covariance.diagonal().tail<3>().setConstant(sigma_rad * sigma_rad);
      motions.push_back({{vision_t.data()[i], vision_t.data()[i + 1]}, motion});
    }
    return motions;
  };
  m.def(
      "calibrate_wheels",
      [motions_of](const Times& wheel_t, const Points2& wheels, const WheelGeometry& geometry,
                   const Times& vision_t, const Poses& poses, double sigma_m, double sigma_rad,
                   const std::optional<Times>& imu_t, const std::optional<Points3>& gyro,
                   const std::optional<Points3>& gyro_bias, const SE3d& T_body_base, const ImuNoise& noise,
                   const std::string& reading, const WheelCalibrationOptions& options) {
        const auto ticks = wheel_samples(wheel_t, wheels, reading_of(reading));
        std::vector<ImuSample> imu;
        if (imu_t && gyro) imu = ImuArrays(*imu_t, *gyro, std::nullopt).samples;
        if (gyro_bias && gyro_bias->size() != 1) require_length(gyro_bias->size(), imu.size(), "gyro_bias");
        const auto motions = motions_of(vision_t, poses, sigma_m, sigma_rad);
        const std::size_t n = motions.size();
        Column<Eigen::Vector4d> parameters(n), sigma(n);
        py::array_t<bool> observed({static_cast<py::ssize_t>(n), py::ssize_t{4}});
        bool* out = observed.mutable_data();
        int used = 0, rejected = 0;
        {
          py::gil_scoped_release release;
          WheelCalibrator calibrator(geometry, T_body_base, noise, options);
          std::size_t k = 0;
          const auto vision = [&](TimeNs until) {
            for (; k < n && motions[k].first.second <= until; ++k) {
              calibrator.add_motion(motions[k].first.first, motions[k].first.second, motions[k].second);
              const WheelParameters p = calibrator.parameters();
              parameters.set(k, {p.scale_left, p.scale_right, p.track_width, calibrator.offset()});
              sigma.set(k, calibrator.covariance().diagonal().cwiseSqrt());
              for (int i = 0; i < 4; ++i) out[4 * k + i] = calibrator.observed()[i];
            }
          };
          merge(
              ticks, imu,
              [&](std::size_t w) {
                calibrator.add(ticks[w]);
                if (imu.empty()) vision(ticks[w].t);
              },
              [&](std::size_t i) {
                if (gyro_bias)
                  calibrator.set_gyro_bias(gyro_bias->as<Vec3<double>>()[gyro_bias->size() == 1 ? 0 : i]);
                calibrator.add(imu[i]);
                vision(imu[i].t);
              });
          vision(std::numeric_limits<TimeNs>::max());
          used = calibrator.used();
          rejected = calibrator.rejected();
        }
        py::dict result;
        result["parameters"] = parameters.array();
        result["sigma"] = sigma.array();
        result["observed"] = observed;
        result["used"] = used;
        result["rejected"] = rejected;
        return result;
      },
      py::arg("wheel_t"), py::arg("wheels"), py::arg("geometry"), py::arg("vision_t"), py::arg("poses"),
      py::arg("sigma_m"), py::arg("sigma_rad"), py::arg("imu_t") = py::none(), py::arg("gyro") = py::none(),
      py::arg("gyro_bias") = py::none(), py::arg("T_body_base") = SE3d(), py::arg("noise") = ImuNoise{},
      py::arg("reading") = "ticks", py::arg("options") = WheelCalibrationOptions{},
      "Calibrates the wheels through a recording against poses of the body (m, 7), x y z qx qy qz qw, by "
      "vision: after each of the m - 1 motions (scale_left, scale_right, track_width [m], offset [s]), their "
      "standard deviations, and which the drive has told. sigma: error of each motion.");
  m.def(
      "detect_slip",
      [motions_of](const Times& wheel_t, const Points2& wheels, const WheelGeometry& geometry,
                   const std::optional<Times>& vision_t, const std::optional<Poses>& poses, double sigma_m,
                   double sigma_rad, const std::optional<Times>& imu_t, const std::optional<Points3>& gyro,
                   const Vector3& gyro_bias, const std::optional<WheelParameters>& parameters,
                   const SE3d& T_body_base, const ImuNoise& noise, const std::string& reading,
                   const SlipOptions& options) {
        const auto ticks = wheel_samples(wheel_t, wheels, reading_of(reading));
        std::vector<ImuSample> imu;
        if (imu_t && gyro) imu = ImuArrays(*imu_t, *gyro, std::nullopt).samples;
        std::vector<std::pair<std::pair<TimeNs, TimeNs>, UncertainMotion<double>>> motions;
        if (vision_t && poses) motions = motions_of(*vision_t, *poses, sigma_m, sigma_rad);
        SlipDetector detector(geometry, T_body_base, noise, options);
        detector.set_gyro_bias(gyro_bias.eigen<Vec3<double>>());
        if (parameters) detector.set_wheels(*parameters);
        {
          py::gil_scoped_release release;
          std::size_t k = 0;
          const auto vision = [&](TimeNs until) {
            for (; k < motions.size() && motions[k].first.second <= until; ++k)
              detector.add_motion(motions[k].first.first, motions[k].first.second, motions[k].second);
          };
          merge(
              ticks, imu,
              [&](std::size_t w) {
                detector.add(ticks[w]);
                if (imu.empty()) vision(ticks[w].t);
              },
              [&](std::size_t i) {
                detector.add(imu[i]);
                vision(imu[i].t);
              });
        }
        py::list episodes;
        auto all = detector.episodes();
        if (detector.current()) all.push_back(*detector.current());
        for (const SlipEpisode& e : all) {
          py::dict d;
          d["begin"] = e.begin;
          d["end"] = e.end;
          d["kind"] = e.kind == SlipEpisode::Kind::free_spin ? "free_spin" : "slip";
          d["rolled"] = e.rolled;
          d["moved"] = e.moved;
          d["worst"] = e.worst;
          episodes.append(d);
        }
        return episodes;
      },
      py::arg("wheel_t"), py::arg("wheels"), py::arg("geometry"), py::arg("vision_t") = py::none(),
      py::arg("poses") = py::none(), py::arg("sigma_m") = 0.002, py::arg("sigma_rad") = 0.002,
      py::arg("imu_t") = py::none(), py::arg("gyro") = py::none(),
      py::arg("gyro_bias") = Vec3<double>(0, 0, 0), py::arg("parameters") = py::none(),
      py::arg("T_body_base") = SE3d(), py::arg("noise") = ImuNoise{}, py::arg("reading") = "ticks",
      py::arg("options") = SlipOptions{},
      "Episodes in which the wheels disagree with the gyro or with vision, as dicts: begin and end [ns], "
      "kind, "
      "rolled and moved [m], worst (squared error over variance).");
}

}  // namespace

void register_motion(py::module_& m) {
  register_structs(m);
  register_integration(m);
  register_wheels(m);
  register_bias(m);
  register_watching(m);
}

}  // namespace sweepkit::python
