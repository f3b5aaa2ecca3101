/* Loaded before the C library: from a numbered write on, everything that writes into one folder fails.

   Orders lie in a file that all processes share, so that they reach processes that were started before. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <unistd.h>

struct orders {
    int64_t from, error, count;
    char folder[PATH_MAX];
};

static struct orders *orders;

__attribute__((constructor)) static void read_orders(void) {
    const char *path = getenv("FPPLAB_REFUSED_WRITES");
    int file = path ? syscall(SYS_openat, AT_FDCWD, path, O_RDWR) : -1;
    if (file < 0) return;
    void *shared = mmap(NULL, sizeof *orders, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    orders = shared == MAP_FAILED ? NULL : shared;
    syscall(SYS_close, file);
}

static int refused(const char *path) {
    size_t length = orders ? strlen(orders->folder) : 0;
    if (!length || !path || strncmp(path, orders->folder, length)) return 0;
    int64_t number = __atomic_add_fetch(&orders->count, 1, __ATOMIC_SEQ_CST);
    if (!orders->from || number < orders->from) return 0;
    errno = (int)orders->error;
    return 1;
}

static int refused_file(int file) {
    char link[64], path[PATH_MAX];
    if (!orders || !orders->folder[0]) return 0;
    snprintf(link, sizeof link, "/proc/self/fd/%d", file);
    ssize_t length = readlink(link, path, sizeof path - 1);
    if (length < 0) return 0;
    path[length] = 0;
    return refused(path);
}

#define NEXT(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

#define WRITES(name, parameters, arguments)                          \
    ssize_t name parameters {                                        \
        return refused_file(file) ? -1 : NEXT(name) arguments;       \
    }

WRITES(write, (int file, const void *data, size_t size), (file, data, size))
WRITES(pwrite, (int file, const void *data, size_t size, off_t at), (file, data, size, at))
WRITES(pwrite64, (int file, const void *data, size_t size, off64_t at), (file, data, size, at))
WRITES(writev, (int file, const struct iovec *parts, int count), (file, parts, count))
WRITES(pwritev, (int file, const struct iovec *parts, int count, off_t at), (file, parts, count, at))
WRITES(pwritev64, (int file, const struct iovec *parts, int count, off64_t at), (file, parts, count, at))

int mkdir(const char *path, mode_t mode) { return refused(path) ? -1 : NEXT(mkdir)(path, mode); }

#define OPENS(name, parameters, arguments)                           \
    int name parameters {                                            \
        va_list more;                                                \
        va_start(more, flags);                                       \
        mode_t mode = flags & O_CREAT ? va_arg(more, mode_t) : 0;    \
        va_end(more);                                                \
        return flags & O_CREAT && refused(path) ? -1 : NEXT(name) arguments; \
    }

OPENS(open, (const char *path, int flags, ...), (path, flags, mode))
OPENS(open64, (const char *path, int flags, ...), (path, flags, mode))
OPENS(openat, (int folder, const char *path, int flags, ...), (folder, path, flags, mode))
OPENS(openat64, (int folder, const char *path, int flags, ...), (folder, path, flags, mode))
