// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstddef>
#include <exception>
#include <thread>
#include <vector>

namespace sweepkit {

/// The number of threads that an option asks for: itself, or, for 0, as many as the machine has.
inline int thread_count(int option) {
  return option > 0 ? option : std::max(1, static_cast<int>(std::thread::hardware_concurrency()));
}

/// Cuts 0 .. count - 1 into `threads` blocks, alike in length to one, and calls body(begin, end, block) for
/// each in a thread of its own, the first in the caller's. The blocks depend on count and threads alone.
/// Returns when all are done; of several exceptions that of the lowest block is thrown on.
/// @param threads 0: as many as the machine has; threads are started at each call (about 20 us each)
template <class Body>
void parallel_blocks(std::size_t count, int threads, Body&& body) {
  const auto blocks = std::min(static_cast<std::size_t>(thread_count(threads)), count);
  if (blocks <= 1) {
    if (count > 0) body(std::size_t{0}, count, std::size_t{0});
    return;
  }
  std::vector<std::exception_ptr> failures(blocks);
  const auto run = [&](std::size_t block) {
    try {
      body(count * block / blocks, count * (block + 1) / blocks, block);
    } catch (...) {
      failures[block] = std::current_exception();
    }
  };
  {
    std::vector<std::jthread> workers;
    workers.reserve(blocks - 1);
    for (std::size_t block = 1; block < blocks; ++block) workers.emplace_back(run, block);
    run(0);
  }
  for (const auto& failure : failures)
    if (failure) std::rethrow_exception(failure);
}

/// Calls body(i) for i in 0 .. count - 1, divided among threads as parallel_blocks does.
template <class Body>
void parallel_for(std::size_t count, int threads, Body&& body) {
  parallel_blocks(count, threads, [&](std::size_t begin, std::size_t end, std::size_t) {
    for (std::size_t i = begin; i < end; ++i) body(i);
  });
}

}  // namespace sweepkit
