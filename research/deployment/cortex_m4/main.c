/* Run an agent on a Cortex-M4 under QEMU, for compiled-in observations and memories; print commands and their cost.

   Each line is one decision: surge and yaw command as the bits of their floats, and the ticks of the system timer.
   Under `-icount shift=0` an instruction takes a nanosecond, and a tick of the 25 MHz timer is 40 instructions. */

#include <stdint.h>
#include <string.h>

#define AUV_AGENT_IMPLEMENTATION
#include "auv_agent.h"
#include "inputs.h"

#define REGISTER(address) (*(volatile uint32_t *)(address))
#define FPU_ACCESS REGISTER(0xE000ED88)
#define TIMER_CONTROL REGISTER(0xE000E010)
#define TIMER_RELOAD REGISTER(0xE000E014)
#define TIMER_VALUE REGISTER(0xE000E018)
#define LARGEST 0xFFFFFFu

enum { WRITE_TEXT = 0x04, EXIT = 0x18, DONE = 0x20026 };

extern uint32_t stack_top;
void reset(void);

__attribute__((section(".vectors"), used)) static const void *const vectors[] = {&stack_top, (const void *)reset};

static void host(int operation, const void *argument)
{
    register int r0 __asm__("r0") = operation;
    register const void *r1 __asm__("r1") = argument;
    __asm__ volatile("bkpt 0xAB" : "+r"(r0) : "r"(r1) : "memory");
}

static char *written(char *text, uint32_t bits)
{
    for (int shift = 28; shift >= 0; shift -= 4) *text++ = "0123456789abcdef"[(bits >> shift) & 15];
    return text;
}

static uint32_t bits_of(float x)
{
    union { float number; uint32_t bits; } both;
    both.number = x;
    return both.bits;
}

__attribute__((noinline)) static void run(void)
{
    static auv_agent_memory memory;
    TIMER_RELOAD = LARGEST;
    TIMER_CONTROL = 5;
    for (int k = 0; k < DECISIONS; k++) {
        float command[2];
        char line[28], *end = line;
        memcpy(&memory, memories[k], sizeof memory);
        TIMER_VALUE = 0;
        uint32_t before = TIMER_VALUE;
        auv_agent_step(&memory, observations[k], command);
        uint32_t ticks = (before - TIMER_VALUE) & LARGEST;
        end = written(end, bits_of(command[0]));
        *end++ = ' ';
        end = written(end, bits_of(command[1]));
        *end++ = ' ';
        end = written(end, ticks);
        *end++ = '\n';
        *end = 0;
        host(WRITE_TEXT, line);
    }
    host(EXIT, (const void *)DONE);
}

void reset(void)
{
    FPU_ACCESS |= 0xFu << 20;
    __asm__ volatile("dsb\n isb");
    run();
    for (;;) {}
}
