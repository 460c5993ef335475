// Copyright 2026 The tdm_planner authors
//
// Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
// in compliance with the License. You may obtain a copy of the License at
// http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
// writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
// WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
// language governing permissions and limitations under the License.

// Preloaded into a process, lets its time of day be set without that of the machine: it is off by
// the nanoseconds in the file that TIME_OF_DAY_OFFSET names. Steady clocks are left alone. What
// waits until a time of day is told that of the machine, which the kernel goes by.
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <pthread.h>
#include <semaphore.h>
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

// Times before 2001 are those of a steady clock, which began when the machine did.
static struct timespec of_machine(const struct timespec *until) {
  struct timespec found = *until;
  if (offset && until->tv_sec > 1000000000) {
    long long time = until->tv_sec * 1000000000LL + until->tv_nsec - *offset;
    found.tv_sec = time / 1000000000LL;
    found.tv_nsec = time % 1000000000LL;
  }
  return found;
}

int pthread_cond_timedwait(pthread_cond_t *restrict condition, pthread_mutex_t *restrict mutex,
                           const struct timespec *restrict until) {
  static int (*wait)(pthread_cond_t *, pthread_mutex_t *, const struct timespec *);
  struct timespec machine = of_machine(until);
  if (!wait) *(void **)&wait = dlvsym(RTLD_NEXT, "pthread_cond_timedwait", "GLIBC_2.3.2");
  if (!wait) *(void **)&wait = dlsym(RTLD_NEXT, "pthread_cond_timedwait");
  return wait(condition, mutex, &machine);
}

int pthread_cond_clockwait(pthread_cond_t *condition, pthread_mutex_t *mutex, clockid_t clock,
                           const struct timespec *until) {
  static int (*wait)(pthread_cond_t *, pthread_mutex_t *, clockid_t, const struct timespec *);
  struct timespec machine = clock == CLOCK_REALTIME ? of_machine(until) : *until;
  if (!wait) *(void **)&wait = dlsym(RTLD_NEXT, "pthread_cond_clockwait");
  return wait(condition, mutex, clock, &machine);
}

int sem_timedwait(sem_t *restrict semaphore, const struct timespec *restrict until) {
  static int (*wait)(sem_t *, const struct timespec *);
  struct timespec machine = of_machine(until);
  if (!wait) *(void **)&wait = dlsym(RTLD_NEXT, "sem_timedwait");
  return wait(semaphore, &machine);
}
