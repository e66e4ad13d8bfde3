// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include <limits>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "arrays.hpp"
#include "options.hpp"
#include "register.hpp"
#include "sweepkit/geometry/alignment.hpp"
#include "sweepkit/geometry/camera.hpp"
#include "sweepkit/geometry/p3p.hpp"
#include "sweepkit/geometry/pnp.hpp"
#include "sweepkit/geometry/rectified_camera.hpp"
#include "sweepkit/geometry/se3.hpp"
#include "sweepkit/geometry/sim3.hpp"
#include "sweepkit/geometry/so3.hpp"
#include "sweepkit/geometry/stereo_rig.hpp"
#include "sweepkit/geometry/triangulation.hpp"

namespace sweepkit::python {

namespace {

using RowsByThree = Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>;
using RowsByTwo = Eigen::Matrix<double, Eigen::Dynamic, 2, Eigen::RowMajor>;

// What the three groups have alike. Tangents are arrays of that length.
template <class Group, class TangentArray>
py::class_<Group> bind_group(py::module_& m, const char* name, const char* doc) {
  using Tangent = typename Group::Tangent;
  const auto tangent = [](const TangentArray& a) { return a.template eigen<Tangent>(); };
  py::class_<Group> cls(m, name, doc);
  cls.def(py::init<>())
      .def_static(
          "exp", [tangent](const TangentArray& xi) { return Group::exp(tangent(xi)); }, py::arg("xi"),
          "Tangent vector to group.")
      .def("log", &Group::log, "The tangent vector, the inverse of exp.")
      .def("inverse", &Group::inverse)
      .def("matrix", &Group::matrix)
      .def("adjoint", &Group::adjoint, "Ad with T Exp(xi) = Exp(Ad xi) T.")
      .def_static(
          "left_jacobian", [tangent](const TangentArray& xi) { return Group::left_jacobian(tangent(xi)); },
          py::arg("xi"), "J_l with Exp(xi + d) = Exp(J_l d) Exp(xi) to first order.")
      .def_static(
          "right_jacobian", [tangent](const TangentArray& xi) { return Group::right_jacobian(tangent(xi)); },
          py::arg("xi"), "J_r with Exp(xi + d) = Exp(xi) Exp(J_r d) to first order.")
      .def_static(
          "left_jacobian_inverse",
          [tangent](const TangentArray& xi) { return Group::left_jacobian_inverse(tangent(xi)); },
          py::arg("xi"))
      .def_static(
          "right_jacobian_inverse",
          [tangent](const TangentArray& xi) { return Group::right_jacobian_inverse(tangent(xi)); },
          py::arg("xi"))
      .def(
          "__mul__", [](const Group& a, const Group& b) { return a * b; }, py::is_operator(),
          py::arg("other"))
      .def(
          "__mul__",
          [](const Group& T, const py::object& points) -> py::object {
            const py::array given = py::array::ensure(points);
            if (given && given.ndim() == 1)
              return py::cast(Vec3<double>(T * points.cast<Vector3>().eigen<Vec3<double>>()));
            const auto rows = points.cast<Points3>();
            RowsByThree result(rows.size(), 3);
            const auto p = rows.as<Vec3<double>>();
            for (std::size_t i = 0; i < p.size(); ++i) result.row(i) = T * p[i];
            return py::cast(std::move(result));
          },
          py::is_operator(), py::arg("points"))
      .def("__copy__", [](const Group& T) { return Group(T); })
      .def(
          "__deepcopy__", [](const Group& T, const py::dict&) { return Group(T); }, py::arg("memo"));
  m.def(
      "interpolate", [](const Group& a, const Group& b, double s) { return interpolate(a, b, s); },
      py::arg("a"), py::arg("b"), py::arg("s"),
      "From a (s = 0) to b (s = 1) along the constant twist between them.");
  return cls;
}

std::string numbers_text(const Eigen::Ref<const Eigen::VectorXd>& v) {
  std::string text = "[";
  for (Eigen::Index i = 0; i < v.size(); ++i) text += (i ? ", " : "") + number_text(v[i]);
  return text + "]";
}

void register_groups(py::module_& m) {
  bind_group<SO3d, Vector3>(m, "SO3d", "Rotations of space; tangents are rotation vectors [rad].")
      .def(py::init([](const Matrix3& R) { return SO3d(R.eigen<Mat3<double>>()); }), py::arg("R"))
      .def_static(
          "from_quaternion",
          [](const ArrayOf<double, 4>& q) {
            const auto v = q.eigen<Eigen::Vector4d>();
            require(v.allFinite() && v.norm() > 0, "SO3d.from_quaternion q", "must be finite and not zero",
                    numbers_text(v));
            return SO3d(Eigen::Quaterniond(v));
          },
          py::arg("q"), "From x, y, z, w; normalised.")
      .def(
          "quaternion", [](const SO3d& R) { return Eigen::Vector4d(R.quaternion().coeffs()); }, "x, y, z, w.")
      .def("angle", &SO3d::angle, "In [0, pi] [rad].")
      .def_static(
          "hat", [](const Vector3& v) { return SO3d::hat(v.eigen<Vec3<double>>()); }, py::arg("v"),
          "The skew matrix [v]x.")
      .def("__repr__",
           [](const SO3d& R) {
             return "SO3d.from_quaternion(" + numbers_text(Eigen::Vector4d(R.quaternion().coeffs())) + ")";
           })
      .def(py::pickle([](const SO3d& R) { return Eigen::Vector4d(R.quaternion().coeffs()); },
                      [](const Eigen::Vector4d& q) { return SO3d(Eigen::Quaterniond(q)); }));
  bind_group<SE3d, Vector6>(m, "SE3d",
                            "Rigid motions; T_a_b takes points in b to a. Tangents are (rho, phi) [m, rad].")
      .def(py::init([](const SO3d& R, const Vector3& t) { return SE3d(R, t.eigen<Vec3<double>>()); }),
           py::arg("R"), py::arg("t"))
      .def(py::init([](const Matrix4& T) { return SE3d(T.eigen<Eigen::Matrix4d>()); }), py::arg("T"))
      .def("rotation", &SE3d::rotation)
      .def("translation", [](const SE3d& T) { return T.translation(); })
      .def("__repr__",
           [](const SE3d& T) {
             return "SE3d(SO3d.from_quaternion(" +
                    numbers_text(Eigen::Vector4d(T.rotation().quaternion().coeffs())) + "), " +
                    numbers_text(T.translation()) + ")";
           })
      .def(py::pickle(
          [](const SE3d& T) { return py::make_tuple(T.rotation(), Vec3<double>(T.translation())); },
          [](const py::tuple& state) { return SE3d(state[0].cast<SO3d>(), state[1].cast<Vec3<double>>()); }));
  bind_group<Sim3d, Vector7>(m, "Sim3d",
                             "Similarities T p = s R p + t. Tangents are (rho, phi, sigma), s = e^sigma.")
      .def(py::init([](const SO3d& R, const Vector3& t, double scale) {
             return Sim3d(R, t.eigen<Vec3<double>>(), scale);
           }),
           py::arg("R"), py::arg("t"), py::arg("scale"))
      .def(py::init([](const SE3d& T) { return Sim3d(T); }), py::arg("T"))
      .def("rotation", &Sim3d::rotation)
      .def("translation", [](const Sim3d& T) { return T.translation(); })
      .def("scale", [](const Sim3d& T) { return T.scale(); })
      .def("__repr__",
           [](const Sim3d& T) {
             return "Sim3d(SO3d.from_quaternion(" +
                    numbers_text(Eigen::Vector4d(T.rotation().quaternion().coeffs())) + "), " +
                    numbers_text(T.translation()) + ", " + number_text(T.scale()) + ")";
           })
      .def(py::pickle(
          [](const Sim3d& T) {
            return py::make_tuple(T.rotation(), Vec3<double>(T.translation()), double(T.scale()));
          },
          [](const py::tuple& state) {
            return Sim3d(state[0].cast<SO3d>(), state[1].cast<Vec3<double>>(), state[2].cast<double>());
          }));
}

Distortion distortion_named(const std::string& name) {
  for (const Distortion d : {Distortion::none, Distortion::radial_tangential, Distortion::equidistant})
    if (to_string(d) == name) return d;
  throw Error(ErrorKind::argument, "Distortion", "must be none, radial-tangential or equidistant", name);
}

// Points for which nothing is returned in C++ are rows of not-a-number in an array, and false in the mask.
template <class Rows, class One>
py::tuple for_each_row(std::size_t count, const One& one) {
  Rows result(count, Rows::ColsAtCompileTime);
  py::array_t<bool> valid(static_cast<py::ssize_t>(count));
  bool* const mask = valid.mutable_data();
  {
    py::gil_scoped_release release;
    for (std::size_t i = 0; i < count; ++i) {
      const auto value = one(i);
      mask[i] = value.has_value();
      if (value)
        result.row(i) = *value;
      else
        result.row(i).setConstant(std::numeric_limits<double>::quiet_NaN());
    }
  }
  return py::make_tuple(std::move(result), std::move(valid));
}

void register_cameras(py::module_& m) {
  py::enum_<Distortion>(m, "Distortion", "How a lens bends the image plane.")
      .value("none", Distortion::none)
      .value("radial_tangential", Distortion::radial_tangential)
      .value("equidistant", Distortion::equidistant);

  py::class_<Camera>(m, "Camera", "A pinhole with its distortion and the size of its image.")
      .def(py::init([](const std::vector<double>& intrinsics,
                       const std::variant<Distortion, std::string>& distortion,
                       const std::vector<double>& coefficients, int width, int height) {
             const auto* name = std::get_if<std::string>(&distortion);
             return Camera(intrinsics, name ? distortion_named(*name) : std::get<Distortion>(distortion),
                           coefficients, width, height);
           }),
           py::arg("intrinsics"), py::arg("distortion"), py::arg("coefficients"), py::arg("width"),
           py::arg("height"), "intrinsics: fx, fy, cx, cy [px].")
      .def_property_readonly("width", &Camera::width)
      .def_property_readonly("height", &Camera::height)
      .def_property_readonly("intrinsics", &Camera::intrinsics, "fx, fy, cx, cy [px].")
      .def_property_readonly("distortion", &Camera::distortion)
      .def_property_readonly("coefficients", &Camera::coefficients)
      .def("K", &Camera::K)
      .def("max_radius", &Camera::max_radius, "Largest |(x/z, y/z)| for which the model holds.")
      .def(
          "contains",
          [](const Camera& c, const Vector2& pixel, double border) {
            return c.contains(pixel.eigen<Vec2<double>>(), border);
          },
          py::arg("pixel"), py::arg("border") = 0.0)
      .def(
          "project", [](const Camera& c, const Vector3& p) { return c.project(p.eigen<Vec3<double>>()); },
          py::arg("p_camera"), "Pixel of a point; None where the camera does not see it.")
      .def(
          "project_jacobian",
          [](const Camera& c,
             const Vector3& p) -> std::optional<std::pair<Vec2<double>, Eigen::Matrix<double, 2, 3>>> {
            Eigen::Matrix<double, 2, 3> J;
            const auto pixel = c.project(p.eigen<Vec3<double>>(), &J);
            if (!pixel) return std::nullopt;
            return std::pair(*pixel, J);
          },
          py::arg("p_camera"), "Pixel and its 2x3 derivative by the point; None as project.")
      .def(
          "unproject",
          [](const Camera& c, const Vector2& pixel) { return c.unproject(pixel.eigen<Vec2<double>>()); },
          py::arg("pixel"), "The ray (x, y, 1); None outside the model's domain.")
      .def(
          "project_all",
          [](const Camera& c, const Points3& points) {
            const auto p = points.as<Vec3<double>>();
            return for_each_row<RowsByTwo>(p.size(), [&](std::size_t i) { return c.project(p[i]); });
          },
          py::arg("points"), "Pixels (n, 2) and a mask (n,) of those that are; the others are nan.")
      .def(
          "unproject_all",
          [](const Camera& c, const Points2& pixels) {
            const auto p = pixels.as<Vec2<double>>();
            return for_each_row<RowsByThree>(p.size(), [&](std::size_t i) { return c.unproject(p[i]); });
          },
          py::arg("pixels"), "Rays (n, 3) and a mask (n,) of those that are; the others are nan.");

  py::class_<RectifiedCamera>(m, "RectifiedCamera", "The rectified left camera of a stereo pair.")
      .def(py::init([](double focal, double cx, double cy, double baseline) {
             return RectifiedCamera{focal, cx, cy, baseline};
           }),
           py::arg("focal"), py::arg("cx"), py::arg("cy"), py::arg("baseline"))
      .def_readwrite("focal", &RectifiedCamera::focal, "[px]")
      .def_readwrite("cx", &RectifiedCamera::cx, "[px]")
      .def_readwrite("cy", &RectifiedCamera::cy, "[px]")
      .def_readwrite("baseline", &RectifiedCamera::baseline, "[m]");

  py::enum_<Side>(m, "Side", "Of a stereo rig.").value("left", Side::left).value("right", Side::right);

  py::class_<StereoRig>(m, "StereoRig", "Two cameras on a body, and the rectified pair that they stand for.")
      .def(py::init<const Camera&, const Camera&, const SE3d&, const SE3d&>(), py::arg("left"),
           py::arg("right"), py::arg("T_body_left"), py::arg("T_body_right"))
      .def(py::init([](const Camera& left, const Camera& right, const Matrix4& T_body_left,
                       const Matrix4& T_body_right) {
             return StereoRig(left, right, T_body_left.eigen<Eigen::Matrix4d>(),
                              T_body_right.eigen<Eigen::Matrix4d>());
           }),
           py::arg("left"), py::arg("right"), py::arg("T_body_left"), py::arg("T_body_right"))
      .def("camera", &StereoRig::camera, py::arg("side"), "The raw camera.")
      .def("T_body_raw", &StereoRig::T_body_raw, py::arg("side"))
      .def("T_left_right", &StereoRig::T_left_right)
      .def_property_readonly("focal", &StereoRig::focal, "Of the rectified pair [px].")
      .def_property_readonly(
          "center", [](const StereoRig& rig) { return rig.center(); }, "Of the rectified pair [px].")
      .def_property_readonly("baseline", &StereoRig::baseline, "[m]")
      .def_property_readonly("is_rectified", &StereoRig::is_rectified)
      .def("T_body_camera", &StereoRig::T_body_camera, "Rectified left camera to body.")
      .def(
          "R_camera_raw", [](const StereoRig& rig, Side side) { return rig.R_camera_raw(side); },
          py::arg("side"))
      .def(
          "rectify",
          [](const StereoRig& rig, Side side, const Points2& pixels) {
            const auto p = pixels.as<Vec2<double>>();
            return for_each_row<RowsByTwo>(p.size(), [&](std::size_t i) { return rig.rectify(side, p[i]); });
          },
          py::arg("side"), py::arg("pixels"),
          "Rectified positions (n, 2) of raw pixels and a mask (n,) of those that are; the others are nan.")
      .def(
          "unrectify",
          [](const StereoRig& rig, Side side, const Points2& rectified) {
            const auto p = rectified.as<Vec2<double>>();
            return for_each_row<RowsByTwo>(p.size(),
                                           [&](std::size_t i) { return rig.unrectify(side, p[i]); });
          },
          py::arg("side"), py::arg("rectified"), "The inverse of rectify.")
      .def("depth_from_disparity", &StereoRig::depth_from_disparity<double>, py::arg("disparity"),
           "[px] to [m].")
      .def(
          "point_from_disparity",
          [](const StereoRig& rig, const Vector3& uvd) {
            return rig.point_from_disparity<double>(uvd.eigen<Vec3<double>>());
          },
          py::arg("uvd"), "(u_left, v, disparity) to the point in the rectified left camera, or None.")
      .def(
          "project_stereo",
          [](const StereoRig& rig, const Vector3& p) {
            return rig.project_stereo<double>(p.eigen<Vec3<double>>());
          },
          py::arg("p_camera"), "The inverse of point_from_disparity; None behind the camera.")
      .def(
          "point_covariance",
          [](const StereoRig& rig, const Vector3& uvd, double sigma_pixel, double sigma_disparity) {
            const auto v = uvd.eigen<Vec3<double>>();
            require(v.z() > 0, "StereoRig.point_covariance uvd", "must have a positive disparity", v.z());
            return rig.point_covariance(v, sigma_pixel, sigma_disparity);
          },
          py::arg("uvd"), py::arg("sigma_pixel"), py::arg("sigma_disparity"));
}

void register_solvers(py::module_& m) {
  using Triangulated = Triangulation<double>;
  py::class_<Triangulated>(m, "Triangulation", "A point seen along several rays.")
      .def_property_readonly("point", [](const Triangulated& t) { return t.point; })
      .def_property_readonly("covariance", [](const Triangulated& t) { return t.covariance; })
      .def_readonly("parallax", &Triangulated::parallax, "Largest angle between two rays [rad].")
      .def_readonly("max_angle", &Triangulated::max_angle, "Between a ray and the point [rad].")
      .def_readonly("in_front", &Triangulated::in_front);
  m.def(
      "triangulate_linear",
      [](const std::vector<SE3d>& T_camera_world, const Points3& bearings, double bearing_sigma,
         int reweightings) {
        return triangulate_linear<double>(T_camera_world, bearings.as<Vec3<double>>(), bearing_sigma,
                                          reweightings);
      },
      py::arg("T_camera_world"), py::arg("bearings"), py::arg("bearing_sigma") = 1e-3,
      py::arg("reweightings") = 1, "Point nearest to any number of rays; None if they do not fix one.");
  m.def(
      "triangulate_midpoint",
      [](const SE3d& T_a_b, const Vector3& a, const Vector3& b, double sigma) {
        return triangulate_midpoint<double>(T_a_b, a.eigen<Vec3<double>>(), b.eigen<Vec3<double>>(), sigma);
      },
      py::arg("T_a_b"), py::arg("bearing_a"), py::arg("bearing_b"), py::arg("bearing_sigma") = 1e-3,
      "Middle of the shortest segment between two rays, in a.");
  m.def(
      "triangulate_inverse_depth",
      [](const SE3d& T_a_b, const Vector3& a, const Vector3& b, double sigma) {
        return triangulate_inverse_depth<double>(T_a_b, a.eigen<Vec3<double>>(), b.eigen<Vec3<double>>(),
                                                 sigma);
      },
      py::arg("T_a_b"), py::arg("bearing_a"), py::arg("bearing_b"), py::arg("bearing_sigma") = 1e-3,
      "Midpoint of two rays weighted by inverse depth, in a.");

  using Aligned = Alignment<double>;
  py::class_<Aligned>(m, "Alignment", "p_dst = scale * R p_src + t.")
      .def_readonly("T_dst_src", &Aligned::T_dst_src, "R and t.")
      .def_readonly("scale", &Aligned::scale)
      .def_readonly("rmse", &Aligned::rmse, "[m]")
      .def_readonly("mirrored", &Aligned::mirrored, "A reflection would fit better.")
      .def(
          "__mul__",
          [](const Aligned& alignment, const Points3& points) {
            RowsByThree result(points.size(), 3);
            const auto p = points.as<Vec3<double>>();
            for (std::size_t i = 0; i < p.size(); ++i) result.row(i) = alignment * p[i];
            return result;
          },
          py::is_operator(), py::arg("points"));
  const auto align = [](bool with_scale) {
    return [with_scale](const Points3& src, const Points3& dst, const std::optional<Numbers>& weights) {
      const auto a = src.as<Vec3<double>>(), b = dst.as<Vec3<double>>();
      const std::span<const double> w =
          weights ? std::span(weights->data(), weights->size()) : std::span<const double>();
      py::gil_scoped_release release;
      return with_scale ? align_sim3<double>(a, b, w) : align_se3<double>(a, b, w);
    };
  };
  m.def("align_se3", align(false), py::arg("src"), py::arg("dst"), py::arg("weights") = py::none(),
        "Rigid motion that brings src nearest to dst; None if it is not determined.");
  m.def("align_sim3", align(true), py::arg("src"), py::arg("dst"), py::arg("weights") = py::none(),
        "The same with a scale.");

  m.def(
      "solve_p3p",
      [](const ArrayOf<double, 3, 3>& points, const ArrayOf<double, 3, 3>& bearings) {
        const auto p = points.as<Vec3<double>>(), b = bearings.as<Vec3<double>>();
        std::array<SE3d, 4> poses;
        const int count = solve_p3p(p.first<3>(), b.first<3>(), poses);
        return std::vector<SE3d>(poses.begin(), poses.begin() + count);
      },
      py::arg("points"), py::arg("bearings"), "T_camera_world of a camera that sees three points; up to 4.");

  bind_options<RansacOptions>(m, "RansacOptions", "Search for a model among outliers.");
  bind_options<PnpOptions>(m, "PnpOptions", "Pose of a camera from points.");
  py::class_<PnpResult>(m, "PnpResult", "A pose from points.")
      .def_readonly("T_world_camera", &PnpResult::T_world_camera)
      .def_property_readonly("covariance", [](const PnpResult& r) { return r.covariance; })
      .def_property_readonly("inliers",
                             [](const PnpResult& r) {
                               return py::array_t<int>(static_cast<py::ssize_t>(r.inliers.size()),
                                                       r.inliers.data());
                             })
      .def_readonly("rmse", &PnpResult::rmse, "[sigmas]")
      .def_readonly("iterations", &PnpResult::iterations);
  m.def(
      "solve_pnp",
      [](const Points3& points, const Points2& rays, double focal, const PnpOptions& options,
         const std::optional<Numbers>& sigmas, const std::optional<Numbers>& right_x, double baseline,
         const std::optional<SE3d>& guess) {
        PnpMatches matches;
        matches.points = points.as<Vec3<double>>();
        matches.rays = rays.as<Vec2<double>>();
        if (sigmas) matches.sigmas = {sigmas->data(), sigmas->size()};
        if (right_x) matches.right_x = {right_x->data(), right_x->size()};
        matches.focal = focal;
        matches.baseline = baseline;
        py::gil_scoped_release release;
        return solve_pnp(matches, options, guess);
      },
      py::arg("points"), py::arg("rays"), py::arg("focal"), py::arg("options") = PnpOptions{},
      py::arg("sigmas") = py::none(), py::arg("right_x") = py::none(), py::arg("baseline") = 0.0,
      py::arg("guess") = py::none(),
      "Pose of a camera from points (n, 3) and rays (x/z, y/z) (n, 2) of which many may be wrong; None if "
      "there "
      "is none.");
}

}  // namespace

void register_geometry(py::module_& m) {
  register_groups(m);
  register_cameras(m);
  register_solvers(m);
}

}  // namespace sweepkit::python
