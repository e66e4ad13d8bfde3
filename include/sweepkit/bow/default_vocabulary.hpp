// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>

#include "sweepkit/bow/vocabulary.hpp"

namespace sweepkit {

/// The vocabulary of ORB descriptors that comes with the library, as part of it: nothing is read or copied.
/// It is tools/initial/orb.swv (10,000 words), for robots that have no file system to look into.
std::shared_ptr<const OrbVocabulary> default_orb_vocabulary();

}  // namespace sweepkit
