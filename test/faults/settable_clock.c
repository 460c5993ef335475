// Copyright 2026 The tdm_planner authors
// SPDX-License-Identifier: Apache-2.0
// Preloaded into a process, lets its time of day be set without that of the machine: it is off by
// the nanoseconds in the file that TIME_OF_DAY_OFFSET names. Steady clocks are left alone.
#define _GNU_SOURCE
#include <fcntl.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

static volatile long long *offset;

__attribute__((constructor)) static void open_offset(void) {
  const char *path = getenv("TIME_OF_DAY_OFFSET");
  int file = path ? open(path, O_RDONLY) : -1;
  if (file >= 0) {
    void *found = mmap(NULL, sizeof *offset, PROT_READ, MAP_SHARED, file, 0);
    if (found != MAP_FAILED) offset = found;
    close(file);
  }
}

int clock_gettime(clockid_t clock, struct timespec *found) {
  int code = (int)syscall(SYS_clock_gettime, clock, found);
  if (code == 0 && offset && (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE)) {
    long long time = found->tv_sec * 1000000000LL + found->tv_nsec + *offset;
    found->tv_sec = time / 1000000000LL;
    found->tv_nsec = time % 1000000000LL;
  }
  return code;
}

int gettimeofday(struct timeval *restrict found, void *restrict zone) {
  struct timespec now;
  int code = clock_gettime(CLOCK_REALTIME, &now);
  (void)zone;
  found->tv_sec = now.tv_sec;
  found->tv_usec = now.tv_nsec / 1000;
  return code;
}

time_t time(time_t *found) {
  struct timespec now;
  clock_gettime(CLOCK_REALTIME, &now);
  if (found) *found = now.tv_sec;
  return now.tv_sec;
}
