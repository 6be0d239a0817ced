/* Preloaded into linux.uml so that it runs on processors with more register state than it knows.
 *
 * User-mode Linux writes the floating-point registers of its processes with
 * ptrace(PTRACE_SETREGSET, pid, NT_X86_XSTATE, {area, length}). Its area has a fixed length, 2,696 bytes in Linux 6.1;
 * the host accepts nothing shorter than all it has (about 11 kB with AMX) and answers EFAULT. This library catches
 * ptrace and hands over an area of the host's full length: the caller's bytes, the rest zero, and XSTATE_BV cut to
 * the components the caller's area holds, which leaves the others in their initial configuration. Every other
 * request, and an area that is long enough, goes to libc as it is.
 *
 * Layout of the area (standard format, header at 512): Intel 64 and IA-32 Architectures Software Developer's Manual,
 * volume 1, section 13.4.
 */
#define _GNU_SOURCE
#include <cpuid.h>
#include <dlfcn.h>
#include <elf.h>
#include <stdarg.h>
#include <stdint.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/types.h>
#include <sys/uio.h>

#define XSTATE_BV 512        /* bytes: where the header begins, with the bit map of the components in use */
#define HEADER_END 576       /* bytes: end of the header */
#define XSTATE_LEAF 0xd      /* CPUID leaf that describes the components */
#define LEGACY_COMPONENTS 3u /* x87 and SSE lie before the header, in every area */
#define AREA_BYTES 65536     /* room for the host's area; more than five times what AMX needs */

typedef long ptrace_function(int, pid_t, void *, void *);

static ptrace_function *libc_ptrace;
/* Static: the stacks of a user-mode kernel are too small for it, and that kernel is one thread that does not
 * preempt itself between filling the area and handing it over. */
static unsigned char area[AREA_BYTES] __attribute__((aligned(64)));

/* Before the program starts: the dynamic linker must not be entered from a kernel stack. */
__attribute__((constructor)) static void find_libc_ptrace(void) {
    *(void **)&libc_ptrace = dlsym(RTLD_NEXT, "ptrace"); /* POSIX's way round ISO C */
}

/* Length of the host's area in bytes, asked of the first process; 0 while it cannot be had. */
static size_t host_length(pid_t pid) {
    static size_t length;
    if (length == 0) {
        struct iovec whole = {area, sizeof area};
        if (libc_ptrace(PTRACE_GETREGSET, pid, (void *)(uintptr_t)NT_X86_XSTATE, &whole) == 0)
            length = whole.iov_len;
    }
    return length;
}

/* Bit map of the components that end within `length` bytes. */
static uint64_t components_within(size_t length) {
    uint64_t held = LEGACY_COMPONENTS;
    unsigned size, offset, c, d;
    for (unsigned component = 2; component < 63; component++)
        if (__get_cpuid_count(XSTATE_LEAF, component, &size, &offset, &c, &d) && offset >= HEADER_END && size > 0 &&
            (size_t)offset + size <= length)
            held |= UINT64_C(1) << component;
    return held;
}

/* SETREGSET with the caller's area widened to `length` bytes; iov_len stays what the caller gave. */
static long set_widened(pid_t pid, const struct iovec *given, size_t length) {
    static size_t known_length;
    static uint64_t held;
    uint64_t in_use;
    struct iovec whole = {area, length};
    if (given->iov_len != known_length) { /* CPUID may trap to a hypervisor: once per length, not per call */
        held = components_within(given->iov_len);
        known_length = given->iov_len;
    }
    memcpy(area, given->iov_base, given->iov_len);
    memset(area + given->iov_len, 0, length - given->iov_len);
    memcpy(&in_use, area + XSTATE_BV, sizeof in_use);
    in_use &= held;
    memcpy(area + XSTATE_BV, &in_use, sizeof in_use);
    return libc_ptrace(PTRACE_SETREGSET, pid, (void *)(uintptr_t)NT_X86_XSTATE, &whole);
}

/* As libc's, which also returns the word of a PEEK request. */
long ptrace(enum __ptrace_request request, ...) {
    va_list arguments;
    va_start(arguments, request);
    pid_t pid = va_arg(arguments, pid_t);
    void *address = va_arg(arguments, void *);
    void *data = va_arg(arguments, void *);
    va_end(arguments);
    if (request == PTRACE_SETREGSET && (uintptr_t)address == NT_X86_XSTATE) {
        const struct iovec *given = data;
        size_t length = host_length(pid);
        if (given->iov_len >= HEADER_END && given->iov_len < length)
            return set_widened(pid, given, length);
    }
    return libc_ptrace(request, pid, address, data);
}
