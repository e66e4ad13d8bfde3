// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <utility>
#include <vector>

namespace sweepkit {

/// "0.1.0".
std::string version();

/// Names and versions of the libraries that the runtime was built with, for summary.json and bug reports.
std::vector<std::pair<std::string, std::string>> library_versions();

}  // namespace sweepkit
