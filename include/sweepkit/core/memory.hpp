// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdio>

namespace sweepkit {

/// The most memory that this process has held in RAM so far, libraries included [MB = 10^6 bytes]; 0 where
/// the system does not say (/proc/self/status, VmHWM). Not getrusage: its figure is inherited from the parent
/// process.
inline double peak_memory_mb() {
  std::FILE* file = std::fopen("/proc/self/status", "r");
  if (!file) return 0.0;
  char line[256];
  double kib = 0.0;
  while (std::fgets(line, sizeof(line), file))
    if (std::sscanf(line, "VmHWM: %lf", &kib) == 1) break;
  std::fclose(file);
  return kib * 1024.0 * 1e-6;
}

}  // namespace sweepkit
