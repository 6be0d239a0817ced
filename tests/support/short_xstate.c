/* A tracer that writes the registers of its child from areas of several lengths, as user-mode Linux does.
 *
 * short_xstate LENGTH: stops a child that has loaded ymm0, sets xmm0 from the first LENGTH bytes of its register
 * area and lets it go on; prints "refused ERRNO" when ptrace refuses, else what the child then finds: "low", whether
 * the half of ymm0 that LENGTH bytes hold is the one set, and "high", the other half: zero, as loaded, or else.
 * LENGTH 0 prints the length of this machine's area. `peek` reads words of the child as a debugger does.
 */
#include <elf.h>
#include <errno.h>
#include <immintrin.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/uio.h>
#include <sys/wait.h>
#include <unistd.h>

#define XMM0 160 /* bytes: place of xmm0 in the area (FXSAVE image) */
enum { LOW_SET = 1, HIGH_ZERO = 2, HIGH_LOADED = 4 };

static const uint64_t loaded[4] = {1, 2, 3, 4};
static const uint64_t set[2] = {0x1111111111111111, 0x2222222222222222};
static const uint64_t zero[2];
static volatile long word = -1;
static unsigned char area[65536] __attribute__((aligned(64)));

static int child(void) {
    uint64_t found[4];
    ptrace(PTRACE_TRACEME, 0, 0, 0);
    __asm__ volatile("vmovdqu %1, %%ymm0\n\tint3\n\tvmovdqu %%ymm0, %0" : "=m"(found) : "m"(loaded) : "xmm0");
    return (memcmp(found, set, 16) ? 0 : LOW_SET) | (memcmp(found + 2, zero, 16) ? 0 : HIGH_ZERO) |
           (memcmp(found + 2, loaded + 2, 16) ? 0 : HIGH_LOADED);
}

static int peek(pid_t pid) {
    errno = 0;
    long good = ptrace(PTRACE_PEEKDATA, pid, (void *)&word, 0);
    int good_errno = errno;
    long bad = ptrace(PTRACE_PEEKDATA, pid, (void *)8, 0);
    return printf("word %ld errno %d, nowhere %ld refused %d\n", good, good_errno, bad, errno == EIO || errno == EFAULT);
}

static int set_registers(pid_t pid, size_t length) {
    struct iovec whole = {area, sizeof area}, part = {area, length};
    int status;
    if (ptrace(PTRACE_GETREGSET, pid, (void *)NT_X86_XSTATE, &whole))
        return perror("GETREGSET"), 3;
    if (length == 0)
        return printf("%zu\n", whole.iov_len), 0;
    memcpy(area + XMM0, set, sizeof set);
    if (ptrace(PTRACE_SETREGSET, pid, (void *)NT_X86_XSTATE, &part))
        return printf("refused %d\n", errno), 0;
    ptrace(PTRACE_CONT, pid, 0, 0);
    waitpid(pid, &status, 0);
    int found = WEXITSTATUS(status);
    return printf("low %s high %s iov_len %zu\n", found & LOW_SET ? "set" : "else",
                  found & HIGH_ZERO ? "zero" : found & HIGH_LOADED ? "loaded" : "else", part.iov_len), 0;
}

int main(int count, char **arguments) {
    int status;
    if (count != 2)
        return 2;
    pid_t pid = fork();
    if (pid == 0)
        _exit(child());
    waitpid(pid, &status, 0);
    int code = strcmp(arguments[1], "peek") ? set_registers(pid, strtoul(arguments[1], 0, 10)) : peek(pid) < 0;
    kill(pid, SIGKILL);
    return code;
}
