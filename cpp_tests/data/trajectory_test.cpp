// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/data/trajectory.hpp"

#include <catch2/catch.hpp>
#include <cstdlib>
#include <fstream>
#include <sstream>

#include "data/error_text.hpp"
#include "scratch_folder.hpp"
#include "sweepkit/core/random.hpp"

using namespace sweepkit;

TEST_CASE("TUM lines carry 9 decimals, exact stamps and a quaternion with w >= 0") {
  const StampedPose pose{1403715273262142976,
                         SE3d(SO3d(Eigen::Quaterniond(-0.5, 0.5, -0.5, 0.5)), {1, -2.5, 1e-9})};
  CHECK(tum_line(pose) ==
        "1403715273.262142976 1.000000000 -2.500000000 0.000000001 -0.500000000 0.500000000 -0.500000000 "
        "0.500000000\n");
  CHECK(tum_line({-1500000000, SE3d()}).substr(0, 13) == "-1.500000000 ");
  CHECK(tum_line({7, SE3d()}).substr(0, 12) == "0.000000007 ");
}

TEST_CASE("a trajectory written as TUM reads back, stamps to the nanosecond") {
  Random random(4);
  Trajectory trajectory;
  TimeNs t = 1403715273262142976;
  for (int i = 0; i < 200; ++i) {
    Vec6<double> xi;
    for (double& x : xi) x = random.normal(0, 2);
    trajectory.push_back({t, SE3d::exp(xi)});
    t += 1 + static_cast<TimeNs>(random.index(1'000'000'000));
  }
  const ScratchFolder folder;
  write_tum(folder / "a.tum", trajectory);
  const Trajectory back = read_trajectory(folder / "a.tum");
  REQUIRE(back.size() == trajectory.size());
  for (std::size_t i = 0; i < back.size(); ++i) {
    CHECK(back[i].t == trajectory[i].t);
    CHECK((back[i].T_world_body.inverse() * trajectory[i].T_world_body).log().norm() < 5e-9);
  }
  {
    TumWriter writer(folder / "b.tum");
    writer.comment("map 0");
    writer.write(trajectory[0]);
    writer.flush();
    std::ifstream file(folder / "b.tum");
    std::stringstream content;
    content << file.rdbuf();
    CHECK(content.str() == "# map 0\n" + tum_line(trajectory[0]));
  }
  CHECK(error_text([] {
          TumWriter writer("/nowhere/a.tum");
        }).find("io: /nowhere/a.tum: cannot be written") == 0);
}

TEST_CASE("TUM, EuRoC and KITTI files are told apart") {
  const ScratchFolder folder;
  const auto tum =
      folder.write("a.txt", "# t x y z qx qy qz qw\n\n1.5e0 1 2 3 0 0 0 1\n+2.000000000 1 2 3 0 0 1 0 \r\n");
  const Trajectory a = read_trajectory(tum);
  REQUIRE(a.size() == 2);
  CHECK(a[0].t == 1'500'000'000);
  CHECK(a[1].t == 2'000'000'000);
  CHECK(a[1].T_world_body.rotation().angle() == Approx(3.14159265));

  folder.write("mav0/state_groundtruth_estimate0/data.csv",
               "#timestamp, ...\n1403715273262142976,1,2,3,0,0,0,1,9,9,9,9,9,9,9,9,9\n");
  const Trajectory b = read_trajectory(folder.path());
  REQUIRE(b.size() == 1);
  CHECK(b[0].t == 1403715273262142976);
  CHECK(b[0].T_world_body.rotation().quaternion().z() == 1.0);

  folder.write("kitti/times.txt", "0.000000e+00\n1.037370e-01\n");
  folder.write("kitti/poses.txt", "1 0 0 4 0 1 0 5 0 0 1 6\n0 -1 0 1 1 0 0 2 0 0 1 3\n");
  const Trajectory c = read_trajectory(folder / "kitti");
  REQUIRE(c.size() == 2);
  CHECK(c[1].t == 103737000);
  CHECK((c[1].T_world_body * Vec3<double>(1, 0, 0) - Vec3<double>(1, 3, 3)).norm() < 1e-12);
}

TEST_CASE("a damaged trajectory is refused with file, line and value") {
  const ScratchFolder folder;
  const auto complaint = [&](const std::string& content) {
    const std::string text = error_text([&] { read_trajectory(folder.write("t", content)); });
    const std::size_t at = text.find((folder / "t").string());
    REQUIRE(at != std::string::npos);
    return text.substr(at + (folder / "t").string().size());
  };
  CHECK(complaint("") == ": holds no poses");
  CHECK(complaint("# only\n") == ": holds no poses");
  CHECK(complaint("1 2 3\n") ==
        ":1: is no pose: 8 columns (TUM), 12 (KITTI) or comma-separated ones (EuRoC) are expected (got 3 "
        "columns)");
  CHECK(complaint("1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0\n") == ":2: needs 8 columns, has 7 (got 2 0 0 0 0 0 0)");
  CHECK(complaint("1 0 0 nan 0 0 0 1\n") == ":1: is not a finite number (got nan)");
  CHECK(complaint("1 0 0 1e 0 0 0 1\n") == ":1: is not a finite number (got 1e)");
  CHECK(complaint("1 0 0 0 0 0 0 0\n") == ":1: the quaternion must have length 1 (got 0)");
  CHECK(complaint("2 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n") ==
        ":2: time goes backwards: the stamp before is 2000000000 ns (got 1000000000 ns)");
  CHECK(complaint("1.5,0,0,0,1,0,0,0\n") == ":1: is not a stamp in whole nanoseconds (got 1.5)");
  CHECK(complaint(std::string(100000, '1')) == ":1: the line is too long: is this a text file?");
  folder.write("times.txt", "0\n");
  CHECK(complaint("1 0 0 0 0 2 0 0 0 0 1 0\n") == ":1: the left 3x3 part is no rotation");
  CHECK(complaint("1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0 0 1 0 0 0 0 1 0\n").find(":2: there is no stamp") == 0);
  CHECK(error_text([&] { read_trajectory(folder / "none"); }).find("io: ") == 0);
  CHECK(error_text([&] { read_trajectory(folder.path()); }).find("holds no true poses") != std::string::npos);
}

TEST_CASE("between two poses the body follows the constant twist, beyond them nothing is known") {
  Vec6<double> xi;
  xi << 1, 2, -1, 0.3, -0.5, 0.9;
  const SE3d start(SO3d::exp({0.1, 0.2, 0.3}), {4, 5, 6});
  const Trajectory trajectory{{1000, start}, {2000, start * SE3d::exp(xi)}, {9000, start}};
  CHECK((interpolate(trajectory, 1000)->inverse() * start).log().norm() < 1e-14);
  CHECK((interpolate(trajectory, 1250)->inverse() * start * SE3d::exp(0.25 * xi)).log().norm() < 1e-13);
  CHECK((interpolate(trajectory, 2000)->inverse() * start * SE3d::exp(xi)).log().norm() < 1e-13);
  CHECK_FALSE(interpolate(trajectory, 999));
  CHECK_FALSE(interpolate(trajectory, 9001));
  CHECK(interpolate(trajectory, 5000, 7000));
  CHECK_FALSE(interpolate(trajectory, 5000, 6999));
  CHECK_FALSE(interpolate({}, 5));
  CHECK(path_length(trajectory) ==
        Approx(2 * (trajectory[1].T_world_body.translation() - start.translation()).norm()));
}

TEST_CASE("the truth of KITTI 06 and of sweephome dev01 is read") {
  const char* data = std::getenv("SWEEPKIT_DATA");
  if (!data) {
    WARN("skipped: SWEEPKIT_DATA is not set");
    return;
  }
  const std::filesystem::path folder(data);
  const Trajectory kitti = read_trajectory(folder / "kitti" / "06_first51");
  CHECK(kitti.size() == 51);
  CHECK(path_length(kitti) == Approx(59.9).margin(0.1));
  const Trajectory dev01 = read_trajectory(folder / "sweephome" / "dev01");
  CHECK(dev01.size() == 11581);
  CHECK(dev01.front().t == 1701775511000000000);
}
