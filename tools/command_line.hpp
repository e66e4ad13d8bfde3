// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "sweepkit/core/option_text.hpp"

namespace sweepkit {

/// A flag of its own for an option that `--set PATH=VALUE` reaches as well. Left out if there is no such
/// option.
struct Shortcut {
  std::string flag;  ///< "--data"
  std::string path;  ///< "data_path"
};

/// A flag that takes a word and is no option: `--truth FILE`.
struct WordFlag {
  std::string flag;
  std::string value_name;  ///< "FILE"
  std::string doc;
  std::string* value;
  bool required = false;
};

/// A flag without a value: `--realtime`.
struct SwitchFlag {
  std::string flag;
  std::string doc;
  bool* value;
};

/// The front of a program.
struct ProgramInfo {
  std::string name;
  std::string purpose;                ///< one sentence, for --help
  std::vector<std::string> examples;  ///< command lines, for --help
  std::vector<Shortcut> shortcuts = {{"--data", "data_path"},
                                     {"--out", "save_path"},
                                     {"--start", "recording.start"},
                                     {"--duration", "recording.duration"}};
  std::vector<WordFlag> words = {};
  std::vector<SwitchFlag> switches = {};
};

/// True once Ctrl-C was pressed or the process was asked to end (SIGINT, SIGTERM). The body then writes what
/// it has and returns; a second Ctrl-C ends the process at once.
bool interrupted();

/// Runs a program as the contract of all programs says. Reads, each over the one before: defaults,
/// CONFIG.yaml (the positional argument), `--set PATH=VALUE`, shortcuts. Serves --help, --version,
/// --dump-config and --help-markdown itself; else calls the body.
/// @param options list_options of the struct that the body reads
/// @return the exit code: what the body returned (0 done, 1 failed at its job); 2 wrong usage or options; 3
/// unreadable
///   or wrong data; 130 interrupted. Errors are one line on stderr.
int run_program(int argc, char** argv, const ProgramInfo& info, const OptionList& options,
                const std::function<int()>& body);

}  // namespace sweepkit
