// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

#include "sweepkit/core/error.hpp"

namespace sweepkit {

/// "kind: what" of the Error that a call throws; empty if it throws none.
template <class Call>
std::string error_text(Call&& call) {
  try {
    call();
  } catch (const Error& error) {
    return std::string(to_string(error.kind())) + ": " + error.what();
  }
  return {};
}

}  // namespace sweepkit
