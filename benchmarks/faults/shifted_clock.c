/* Preloaded into a node, this sets its clock ahead of the machine's, or back: by the nanoseconds in the file STRESSBOT_CLOCK,
   which may change at any moment. Only the date (CLOCK_REALTIME) is set, as by `date -s`; the monotonic clock goes on. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <semaphore.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/time.h>
#include <time.h>

#define SECOND 1000000000LL

static volatile int64_t *ahead;
static int (*real)(clockid_t, struct timespec *);

__attribute__((constructor)) static void open_clock(void) {
  real = dlsym(RTLD_NEXT, "clock_gettime");
  const char *path = getenv("STRESSBOT_CLOCK");
  int file = path ? open(path, O_RDONLY) : -1;
  void *map = file < 0 ? MAP_FAILED : mmap(NULL, sizeof *ahead, PROT_READ, MAP_SHARED, file, 0);
  if (map == MAP_FAILED) abort();
  ahead = map;
}

static struct timespec shifted(struct timespec time, int64_t by) {
  int64_t nanoseconds = time.tv_sec * SECOND + time.tv_nsec + by;
  return (struct timespec){nanoseconds / SECOND, nanoseconds % SECOND};
}

int clock_gettime(clockid_t clock, struct timespec *time) {
  if (!real) real = dlsym(RTLD_NEXT, "clock_gettime");
  int result = real(clock, time);
  if (result == 0 && ahead && (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE)) *time = shifted(*time, *ahead);
  return result;
}

int gettimeofday(struct timeval *time, void *zone) {
  struct timespec now;
  (void)zone;
  if (clock_gettime(CLOCK_REALTIME, &now)) return -1;
  *time = (struct timeval){now.tv_sec, now.tv_nsec / 1000};
  return 0;
}

time_t time(time_t *result) {
  struct timespec now;
  clock_gettime(CLOCK_REALTIME, &now);
  if (result) *result = now.tv_sec;
  return now.tv_sec;
}

/* Who waits until a date means the date of this clock; the kernel knows that of the machine only. A deadline before 2001 is
   one of the monotonic clock. */
static clockid_t machine(const struct timespec *deadline, struct timespec *moved) {
  int date = deadline->tv_sec > SECOND;
  *moved = date ? shifted(*deadline, -*ahead) : *deadline;
  return date ? CLOCK_REALTIME : CLOCK_MONOTONIC;
}

int pthread_cond_timedwait(pthread_cond_t *condition, pthread_mutex_t *mutex, const struct timespec *deadline) {
  struct timespec moved;
  clockid_t clock = machine(deadline, &moved);
  return pthread_cond_clockwait(condition, mutex, clock, &moved);
}

int pthread_mutex_timedlock(pthread_mutex_t *mutex, const struct timespec *deadline) {
  struct timespec moved;
  clockid_t clock = machine(deadline, &moved);
  return pthread_mutex_clocklock(mutex, clock, &moved);
}

int sem_timedwait(sem_t *semaphore, const struct timespec *deadline) {
  struct timespec moved;
  clockid_t clock = machine(deadline, &moved);
  return sem_clockwait(semaphore, clock, &moved);
}
