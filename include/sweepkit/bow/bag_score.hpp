// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "sweepkit/bow/bag.hpp"

namespace sweepkit {

/// How alike two bags of one vocabulary are, by the vocabulary's score; see BagScore for the ranges. Bags
/// must be normalised as BagMaker does. For BagScore::kl the order matters: it is the divergence of b from a.
/// Empty bags are alike to nothing: 0 (for kl the largest double).
double bag_score(const Bag& a, const Bag& b, BagScore score);

}  // namespace sweepkit
