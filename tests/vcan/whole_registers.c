/* Lets User-Mode Linux 6.1 run on processors with AMX, by LD_PRELOAD.
 *
 * It keeps 2,696 bytes of a process's extended registers (XSAVE) and sets as many. With AMX they
 * are 11,008, and the host refuses to set a part ("ptrace set fp regs failed, errno = 14"): the
 * guest's first process dies. Here what is set goes over the process's whole registers of now; the
 * rest, the tiles, no process has without asking the host for it, which the guest cannot.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <elf.h>
#include <stdarg.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/uio.h>

typedef long ptrace_function(enum __ptrace_request, ...);

static char registers[1 << 16];

long ptrace(enum __ptrace_request request, ...) {
    static ptrace_function *libc_ptrace;
    if (!libc_ptrace) libc_ptrace = (ptrace_function *)dlsym(RTLD_NEXT, "ptrace");

    va_list arguments;
    va_start(arguments, request);
    long process = va_arg(arguments, long);
    void *address = va_arg(arguments, void *);
    void *data = va_arg(arguments, void *);
    va_end(arguments);

    if (request != PTRACE_SETREGSET || address != (void *)NT_X86_XSTATE)
        return libc_ptrace(request, process, address, data);
    const struct iovec *part = data;
    struct iovec whole = {registers, sizeof registers};
    if (libc_ptrace(PTRACE_GETREGSET, process, address, &whole) < 0) return -1;
    memcpy(registers, part->iov_base, part->iov_len);
    return libc_ptrace(request, process, address, &whole);
}
