// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "command_line.hpp"

#include <fmt/format.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <csignal>
#include <cstdio>

#include "sweepkit/core/version.hpp"

namespace sweepkit {
namespace {

constexpr int kWrongUsage = 2;
constexpr int kWrongData = 3;
constexpr int kInterrupted = 130;

volatile std::sig_atomic_t interrupt_flag = 0;

void on_signal(int) { interrupt_flag = 1; }

void catch_signals() {
  struct sigaction action = {};
  action.sa_handler = on_signal;
  // The handler serves once: the second signal has its usual effect.
  action.sa_flags = static_cast<int>(SA_RESETHAND);
  sigaction(SIGINT, &action, nullptr);
  sigaction(SIGTERM, &action, nullptr);
}

int complain(const ProgramInfo& info, const std::string& message, int code) {
  // A progress line may stand on the terminal.
  fmt::print(stderr, "{}{}: {}\n", isatty(STDERR_FILENO) ? "\r\x1b[K" : "", info.name, message);
  return code;
}

int exit_code(ErrorKind kind) {
  return kind == ErrorKind::argument || kind == ErrorKind::option ? kWrongUsage : kWrongData;
}

std::string examples_text(const ProgramInfo& info) {
  std::string text;
  for (const auto& example : info.examples) text += "  " + example + "\n";
  return text.empty() ? text : "\nExamples:\n" + text;
}

}  // namespace

bool interrupted() { return interrupt_flag != 0; }

int run_program(int argc, char** argv, const ProgramInfo& info, const OptionList& options,
                const std::function<int()>& body) {
  CLI::App app(info.purpose, info.name);
  app.set_help_flag("-h,--help", "Say this, with every option, its unit, default and range");
  app.set_version_flag("--version", info.name + " " + version(), "Print the version, and end");
  std::string config;
  std::vector<std::string> assignments;
  bool dump_config = false, help_markdown = false;
  if (!options.empty()) {
    app.add_option("CONFIG", config, "YAML file with options");
    app.add_option("--set", assignments, "Set an option; may be given many times")
        ->type_name("PATH=VALUE")
        ->take_all()
        ->allow_extra_args(false);
    app.add_flag("--dump-config", dump_config, "Print the whole configuration with comments, and end");
    app.add_flag("--help-markdown", help_markdown, "Print all options as a page of documentation, and end");
  }

  std::vector<std::pair<const Shortcut*, std::string>> given;
  given.reserve(info.shortcuts.size());
  for (const Shortcut& shortcut : info.shortcuts) {
    const OptionRef* option = options.find(shortcut.path);
    if (!option) continue;
    given.emplace_back(&shortcut, "");
    std::string doc = "Option " + shortcut.path + ": " + option->doc;
    app.add_option(shortcut.flag, given.back().second, doc)
        ->type_name(option->unit.empty() ? "VALUE" : option->unit);
  }
  for (const WordFlag& word : info.words)
    app.add_option(word.flag, *word.value, word.doc + (word.required ? " (required)" : ""))
        ->type_name(word.value_name);
  for (const SwitchFlag& flag : info.switches) app.add_flag(flag.flag, *flag.value, flag.doc);
  app.footer([&] {
    return examples_text(info) +
           (options.empty()
                ? ""
                : "\nOptions of the configuration, for CONFIG and --set:\n" + options_help(options));
  });

  try {
    app.parse(argc, argv);
  } catch (const CLI::Success& success) {
    return app.exit(success);
  } catch (const CLI::ParseError& error) {
    return complain(info, std::string(error.what()) + "; see --help", kWrongUsage);
  }

  try {
    try {
      if (!config.empty()) read_yaml_options(options, config);
    } catch (const Error& error) {
      // A configuration that is not there is wrong usage, not wrong data.
      return complain(info, error.what(), kWrongUsage);
    }
    for (const auto& assignment : assignments) set_option(options, assignment, "--set");
    for (const auto& [shortcut, value] : given)
      if (app.count(shortcut->flag) > 0) set_option(options, shortcut->path + "=" + value, shortcut->flag);
    if (dump_config) {
      fmt::print("# {} {}: {}\n{}", info.name, version(), info.purpose, options_to_yaml(options));
      return 0;
    }
    if (help_markdown) {
      fmt::print("{}", options_to_markdown(options, "Options of " + info.name));
      return 0;
    }
    // Not left to CLI11: --dump-config needs none of them.
    for (const WordFlag& word : info.words)
      if (word.required && app.count(word.flag) == 0)
        return complain(info, word.flag + " " + word.value_name + " is required; see --help", kWrongUsage);
    catch_signals();
    const int code = body();
    return interrupted() ? kInterrupted : code;
  } catch (const Error& error) {
    return complain(info, error.what(), exit_code(error.kind()));
  } catch (const std::exception& error) {
    return complain(info, std::string("failed: ") + error.what(), 1);
  }
}

}  // namespace sweepkit
