# SPDX-FileCopyrightText: The sweepkit authors
# SPDX-License-Identifier: Apache-2.0
"""Installs a build into a staging folder, builds the consumer project against it and runs the result.

    check.py runtime|headers BUILD_DIR

The headers are installed and used without anything but Eigen to be found. Prints how long the consumer's one file
took to compile at -O2.
"""

import os
import pathlib
import shutil
import subprocess
import sys
import time

HERE = pathlib.Path(__file__).resolve().parent
HIDDEN = ["OpenCV", "Ceres", "yaml-cpp", "fmt", "nlohmann_json", "Threads"]


def call(*command):
    done = subprocess.run(list(map(str, command)), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    if done.returncode:
        sys.exit(f"{' '.join(map(str, command))}\n{done.stdout}\nfailed with {done.returncode}")
    return done.stdout


def main():
    component, build = sys.argv[1], pathlib.Path(sys.argv[2]).resolve()
    work = build / "consumer" / component
    shutil.rmtree(work, ignore_errors=True)
    stage, mine = work / "stage", work / "build"
    generator = ["-G", "Ninja"] if shutil.which("ninja") else []
    hide = []
    if component == "headers":
        hide = [f"-DCMAKE_DISABLE_FIND_PACKAGE_{name}=ON" for name in HIDDEN]
        source = HERE.parent.parent
        call("cmake", *generator, "-S", source, "-B", work / "headers_only", "-DSWEEPKIT_BUILD_RUNTIME=OFF", *hide)
        call("cmake", "--install", work / "headers_only", "--prefix", stage)
    else:
        call("cmake", "--install", build, "--prefix", stage)
    call("cmake", *generator, "-S", HERE, "-B", mine, f"-DCMAKE_PREFIX_PATH={stage}", "-DCMAKE_BUILD_TYPE=Release",
         f"-DCONSUMER_COMPONENT={component}", "-DCMAKE_EXPORT_COMPILE_COMMANDS=ON", *hide)
    # The object alone first, so that linking is not counted; the user's ccache must not answer for the compiler.
    os.environ["CCACHE_DISABLE"] = "1"
    start = time.monotonic()
    if generator:
        call("ninja", "-C", mine, f"CMakeFiles/consumer.dir/{component}.cpp.o")
    else:
        call("make", "-C", mine, f"{component}.o")
    seconds = time.monotonic() - start
    call("cmake", "--build", mine)
    print(call(mine / "consumer").rstrip())
    print(f"consumer ({component}): compiled in {seconds:.1f} s at -O2")


main()
