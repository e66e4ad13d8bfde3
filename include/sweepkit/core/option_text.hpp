// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <string>
#include <string_view>

#include "sweepkit/core/options.hpp"

namespace sweepkit {

// How options are read and written as text. All take the list that list_options(struct) gives.
// Values are given as in YAML: true or false (also 1, 0, yes, no, on, off), numbers, words, lists [1, 2].
// All errors are Error(option); their place has file and line, where there is a file, and the path of the
// option; their value is what was given. An option whose value is refused keeps the one it had.

/// Reads a YAML file. Keys that are missing keep their values. An unknown key is refused, naming the nearest
/// known one; so is a key that stands twice, a value of the wrong type, out of its range, or not finite.
/// @throws Error(io) if the file cannot be read
void read_yaml_options(const OptionList& options, const std::filesystem::path& file);

/// The same from text. @param name stands in errors where the file would
void parse_yaml_options(const OptionList& options, const std::string& text, const std::string& name);

/// Sets one option from "path.to.key=value". @param place stands before the path in errors, "--set"
void set_option(const OptionList& options, std::string_view assignment, const std::string& place = {});

/// The known path that is most like `path`: by edit distance of the whole or of its last name.
std::string nearest_option(const OptionList& options, std::string_view path);

/// A YAML file with the present values; above each key its documentation, unit, range or choices, and
/// default. Reading it back gives the same values.
std::string options_to_yaml(const OptionList& options);

/// The present values as one JSON object, groups as objects in it.
std::string options_to_json(const OptionList& options);

/// The options as a text for --help: path, type, default, unit, range, documentation.
std::string options_help(const OptionList& options);

/// The options as a page of documentation: a table for each group.
std::string options_to_markdown(const OptionList& options, const std::string& title);

}  // namespace sweepkit
