/* Preloaded into a driver, this lets one kind of call fail, or hang, in the gate that the driver starts: which kind, how, and in
   which process stands in the file STRESSBOT_CALLS, which may change at any moment. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

enum call { NONE, WRITE, SEND, SENDMSG, RECV, RECVMSG, POLL, MMAP, CLOSE };

static volatile struct { int32_t pid, call, hang; } *order;

__attribute__((constructor)) static void open_order(void) {
  const char *path = getenv("STRESSBOT_CALLS");
  int file = path ? open(path, O_RDONLY) : -1;
  void *map = file < 0 ? MAP_FAILED : mmap(NULL, sizeof *order, PROT_READ, MAP_SHARED, file, 0);
  if (map == MAP_FAILED) abort();
  order = map;
}

static int fails(enum call call) {
  static int (*sleeping)(clockid_t, int, const struct timespec *, struct timespec *);
  if (!order || order->call != (int32_t)call || order->pid != getpid()) return 0;
  if (!sleeping) sleeping = dlsym(RTLD_NEXT, "clock_nanosleep");
  while (order->hang && order->call == (int32_t)call) sleeping(CLOCK_MONOTONIC, 0, &(struct timespec){0, 1000000}, NULL);
  if (order->call != (int32_t)call) return 0;
  errno = EIO;
  return 1;
}

#define REPLACED(type, name, number, parameters, arguments) \
  type name parameters { \
    static type(*real) parameters; \
    if (!real) real = dlsym(RTLD_NEXT, #name); \
    return fails(number) ? (type)-1 : real arguments; \
  }

REPLACED(ssize_t, write, WRITE, (int fd, const void *data, size_t size), (fd, data, size))
REPLACED(ssize_t, send, SEND, (int fd, const void *data, size_t size, int flags), (fd, data, size, flags))
REPLACED(ssize_t, sendmsg, SENDMSG, (int fd, const struct msghdr *message, int flags), (fd, message, flags))
REPLACED(ssize_t, recv, RECV, (int fd, void *data, size_t size, int flags), (fd, data, size, flags))
REPLACED(ssize_t, recvmsg, RECVMSG, (int fd, struct msghdr *message, int flags), (fd, message, flags))
REPLACED(int, poll, POLL, (struct pollfd *fds, nfds_t count, int timeout), (fds, count, timeout))
REPLACED(void *, mmap, MMAP, (void *at, size_t size, int prot, int flags, int fd, off_t off), (at, size, prot, flags, fd, off))
REPLACED(void *, mmap64, MMAP, (void *at, size_t size, int prot, int flags, int fd, off_t off), (at, size, prot, flags, fd, off))
REPLACED(int, close, CLOSE, (int fd), (fd))
