#!/usr/bin/python3
# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
"""How a robot uses the Sweeper from Python: three threads feed it as drivers would, a fourth asks where the robot is a
hundred times a second. The drivers here play a recording at sensor time, or as fast as it goes with --fast.

    feed_sweeper.py RECORDING [--fast]
"""

import argparse
import queue
import threading
import time

import numpy as np
import sweepkit as sk


class SensorTime:
    """The clock of the sensors."""

    def __init__(self, begin, fast):
        self.begin, self.fast, self.start, self.newest = begin, fast, time.monotonic(), begin

    def wait_until(self, t):
        """Returns when a sample of this stamp [ns] comes from its sensor."""
        if not self.fast:
            time.sleep(max(0.0, self.start + (t - self.begin) * 1e-9 - time.monotonic()))
        self.newest = max(self.newest, t)


def drive(channel, clock, robot, fast=False):
    """Feeds what comes through the channel. With `fast` an image waits until the one before is done."""
    fed = 0
    while (sample := channel.get()) is not None:
        while fast:
            counts = robot.counts()
            if fed - counts.images - counts.images_dropped - counts.samples_dropped <= 1:
                break
            time.sleep(0.001)
        clock.wait_until(sample.t)
        robot.feed(sample)
        fed += 1


def watch(robot, clock, done):
    next_line = clock.begin
    while not done.wait(0.01):
        now = clock.newest
        pose = robot.pose_at(now)
        if pose is not None and now >= next_line:
            x, y, z = pose.T_frame_body.translation()
            sigma = 1e3 * np.sqrt(np.trace(pose.covariance[:3, :3]))
            print(f"{(now - clock.begin) * 1e-9:8.2f} s  at {x:7.3f} {y:7.3f} {z:7.3f} m, +- {sigma:.1f} mm, by {pose.basis.name}")
            next_line = now + 1_000_000_000


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording")
    parser.add_argument("--fast", action="store_true", help="as fast as images can be tracked")
    given = parser.parse_args()

    recording = sk.data.open_recording(given.recording)
    robot = sk.system.Sweeper(recording.stereo_rig(), sk.system.SweeperOptions(realtime=True))
    clock = SensorTime(recording.info.begin, given.fast)
    # Two seconds of a fast IMU, so that no sensor's thread holds up the reading of the others.
    channels = {kind: queue.Queue(400) for kind in (sk.data.ImuSample, sk.data.WheelSample, sk.data.StereoImage)}
    drivers = [threading.Thread(target=drive, args=(channel, clock, robot, given.fast and kind is sk.data.StereoImage))
               for kind, channel in channels.items()]
    done = threading.Event()
    control = threading.Thread(target=watch, args=(robot, clock, done))
    for thread in (*drivers, control):
        thread.start()
    try:
        for sample in recording:
            channels[type(sample)].put(sample)
    finally:
        for channel in channels.values():
            channel.put(None)
        for thread in drivers:
            thread.join()
        robot.finish()
        done.set()
        control.join()
    counts = robot.counts()
    print(f"{counts.images} images: {counts.images_lost} lost, {counts.images_dropped} dropped; "
          f"{counts.imu_samples} of the IMU, {counts.wheel_samples} of the wheels")


if __name__ == "__main__":
    main()
