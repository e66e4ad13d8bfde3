// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "sweepkit/bow/default_vocabulary.hpp"

#include <span>

// The file's bytes, put here by the assembler.
__asm__(
    ".pushsection .rodata\n"
    ".balign 64\n"
    ".local sweepkit_orb_vocabulary\n"
    "sweepkit_orb_vocabulary:\n"
    ".incbin \"" SWEEPKIT_ORB_VOCABULARY
    "\"\n"
    ".local sweepkit_orb_vocabulary_end\n"
    "sweepkit_orb_vocabulary_end:\n"
    ".popsection\n");

extern "C" {
extern const std::byte sweepkit_orb_vocabulary[] __attribute__((visibility("hidden")));
extern const std::byte sweepkit_orb_vocabulary_end[] __attribute__((visibility("hidden")));
}

namespace sweepkit {

std::shared_ptr<const OrbVocabulary> default_orb_vocabulary() {
  static const auto vocabulary = std::make_shared<const OrbVocabulary>(VocabularyImage::of_bytes(
      {sweepkit_orb_vocabulary, sweepkit_orb_vocabulary_end}, "default vocabulary"));
  return vocabulary;
}

}  // namespace sweepkit
