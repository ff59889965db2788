/* Stands in for OpenHaptics' libHD in tests: the same calls, a servo thread, and the rules of its frames. */
#include <pthread.h>
#include <stdint.h>
#include <string.h>
#include <unistd.h>

typedef unsigned int HDenum;
typedef struct { unsigned code; int internal; unsigned device; } HDErrorInfo;

static double position[3], velocity[3], force[3];
static int buttons, calibrated, enabled, running, in_frame, in_servo, opened;
static unsigned error;
static volatile int ticks;
static unsigned (*callback)(void *);
static pthread_t thread;

static void *servo(void *unused) {
    (void)unused;
    while (running) {
        in_servo = 1;
        if (callback && callback(0) == 0) callback = 0;
        in_servo = 0;
        ticks++;
        usleep(1000);
    }
    return 0;
}

unsigned hdInitDevice(const char *name) {
    if (name && strcmp(name, "Default Device")) { error = 0x0300; return 0xFFFFFFFFu; }
    opened = 1; calibrated = 0;
    return 7;
}
void hdDisableDevice(unsigned device) { if (device == 7) opened = enabled = 0; else error = 0x0104; }
void hdEnable(HDenum what) { if (what == 0x4000) enabled = 1; else error = 0x0100; }
void hdDisable(HDenum what) { if (what == 0x4000) enabled = 0; else error = 0x0100; }
void hdStartScheduler(void) { running = 1; pthread_create(&thread, 0, servo, 0); }
void hdStopScheduler(void) { if (running) { running = 0; pthread_join(thread, 0); } memset(force, 0, sizeof force); }
unsigned long hdScheduleAsynchronous(unsigned (*call)(void *), void *data, unsigned short priority) {
    (void)data; (void)priority;
    callback = call;
    return 3;
}
void hdUnschedule(unsigned long handle) { if (handle == 3) callback = 0; }
void hdBeginFrame(unsigned device) { if (device != 7 || in_frame || !in_servo) error = 0x0400; in_frame = 1; }
void hdEndFrame(unsigned device) { if (device != 7 || !in_frame) error = 0x0401; in_frame = 0; }
void hdGetDoublev(HDenum what, double *values) {
    if (what == 0x2603) { values[0] = 3.3; return; }
    if (!in_frame) error = 0x0402;
    else if (what == 0x2050) memcpy(values, position, sizeof position);
    else if (what == 0x2051) memcpy(values, velocity, sizeof velocity);
    else error = 0x0100;
}
void hdGetIntegerv(HDenum what, int *value) {
    if (what == 0x2555) *value = 2;
    else if (what == 0x2000 && in_frame) *value = buttons;
    else error = 0x0100;
}
void hdSetDoublev(HDenum what, const double *values) {
    if (what != 0x2700 || !in_frame) error = 0x0402;
    else if (enabled) memcpy(force, values, sizeof force);
}
HDErrorInfo hdGetError(void) {
    HDErrorInfo info = {error, 0, 7};
    error = 0;
    return info;
}
HDenum hdCheckCalibration(void) { return calibrated ? 0x5000 : 0x5001; }
void hdUpdateCalibration(HDenum style) { if (style == 2) calibrated = 1; else error = 0x0100; }

/* What the test does to the device, and sees of it. */
void stand_in_move(const double *to, const double *at_speed) {
    memcpy(position, to, sizeof position);
    memcpy(velocity, at_speed, sizeof velocity);
}
void stand_in_press(int mask) { buttons = mask; }
void stand_in_unplug(void) { error = 0x0302; }
void stand_in_force(double *values) { memcpy(values, force, sizeof force); }
int stand_in_open(void) { return opened; }
int stand_in_ticks(void) { return ticks; }
