/* Start of a Cortex-M4F in qemu (mps2-an386), and its instruction count: with -icount shift=0 an
 * instruction takes 1 ns, and the system timer counts each 40 ns. */
#include <stdint.h>

#define TIMER_CONTROL (*(volatile uint32_t *)0xE000E010U)
#define TIMER_RELOAD (*(volatile uint32_t *)0xE000E014U)
#define TIMER_VALUE (*(volatile uint32_t *)0xE000E018U)
#define COPROCESSORS (*(volatile uint32_t *)0xE000ED88U)

extern void _start(void);
extern uint32_t __stack;

uint32_t ticks_since(uint32_t before)
{
    return (before - TIMER_VALUE) & 0xFFFFFFU;
}

uint32_t ticks(void)
{
    return TIMER_VALUE;
}

__attribute__((naked)) void reset(void)
{
    __asm__ volatile("ldr r0, =0xE000ED88\n ldr r1, [r0]\n orr r1, r1, #0xF00000\n str r1, [r0]\n"
                     "dsb\n isb\n b begin\n");
}

__attribute__((used)) void begin(void)
{
    TIMER_RELOAD = 0xFFFFFFU;
    TIMER_VALUE = 0U;
    TIMER_CONTROL = 5U;
    _start();
}

__attribute__((section(".vectors"), used)) void *const vectors[16] = {&__stack, (void *)reset};
