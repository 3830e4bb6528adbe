/* Corrects PoCL 3.0 of pip. It names processors by LLVM 14, which takes newer ones for others or for none, but links
 * built-in functions chosen by the processor's features. Where the two have vectors of different widths, kernels are
 * wrong or never end. No option sets the name, so it is written into PoCL's memory, as by gpusim/backends/pocl.py.
 * SPDX-License-Identifier: BSD-3-Clause */
#define CL_TARGET_OPENCL_VERSION 120
#include <CL/cl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { SEARCHED = 2048, NAME = 32, TEXT = 1024, FLAGS = 1 << 14 };
#define HASWELL "avx2 bmi1 bmi2 abm cx16 f16c fma movbe popcnt"
/* Processors to build for, best first, and the features that their code uses. */
static const char *const processors[][2] = {
    {"skylake-avx512", HASWELL " avx512f avx512bw avx512cd avx512dq avx512vl"}, {"haswell", HASWELL},
    {"sandybridge", "avx cx16 popcnt sse4_2"}, {"x86-64", "sse2"}};
/* LLVM 14's names of processors with vectors of 64 and of 32 bytes. */
static const char *const with_avx512 = "knl knm skylake-avx512 cascadelake cooperlake cannonlake icelake-client "
                                       "icelake-server rocketlake tigerlake sapphirerapids";
static const char *const with_avx = "sandybridge ivybridge haswell broadwell skylake alderlake btver2 bdver1 bdver2 "
                                    "bdver3 bdver4 znver1 znver2 znver3";

static int has_words(const char *text, const char *words) {
    char word[NAME + 1], padded[FLAGS + 2]; int used;
    snprintf(padded, sizeof padded, " %s ", text);
    for (word[0] = ' '; sscanf(words, "%29s%n", word + 1, &used) == 1; words += used)
        if (!strstr(padded, strcat(word, " "))) return 0;
    return 1;
}
static void read_features(char *flags) {
    FILE *file = fopen("/proc/cpuinfo", "r");
    while (file && fgets(flags, FLAGS, file) && strncmp(flags, "flags", 5)) flags[0] = 0;
    if (file) fclose(file);
    flags[strcspn(flags, "\n")] = 0;
}
/* Reads bytes at an address, zeros where there are none: unmapped memory is an error of the file, not a crash. */
static void read_memory(FILE *memory, size_t address, void *bytes, size_t count) {
    memset(bytes, 0, count);
    if (address >> 47 || fseek(memory, (long)address, SEEK_SET) || !fread(bytes, 1, count, memory)) clearerr(memory);
}
/* Writes `name` over `wrong` in PoCL's structure of the device: its first pointer to one of both. Returns success. */
static int rename_processor(cl_device_id device, const char *wrong, const char *name) {
    FILE *memory = fopen("/proc/self/mem", "rb"); char text[NAME + 1] = ""; int is_done = 0;
    if (memory) setvbuf(memory, NULL, _IONBF, 0);
    for (size_t place = 0; memory && !is_done && place < SEARCHED; place += sizeof(char *)) {
        size_t address; read_memory(memory, (size_t)device + place, &address, sizeof address);
        read_memory(memory, address, text, NAME);
        is_done = !strcmp(text, wrong) || !strcmp(text, name);
        if (!is_done || !strcmp(text, name)) continue;
        char *copy = malloc(NAME); /* PoCL may free it, as it would its own */
        if (!copy) break;
        strcpy(copy, name); memcpy((char *)device + place, &copy, sizeof copy);
    }
    if (memory) fclose(memory);
    return is_done;
}
const char *correct_processor(cl_device_id device);
/* Corrects the processor that PoCL builds for, before the first build. Returns its new name, "" if nothing was to be
 * corrected, and NULL if it is wrong and cannot be corrected. */
const char *correct_processor(cl_device_id device) {
    char version[TEXT] = "", driver[TEXT] = "", flags[FLAGS] = "";
    clGetDeviceInfo(device, CL_DEVICE_VERSION, sizeof version, version, NULL);
    clGetDeviceInfo(device, CL_DRIVER_VERSION, sizeof driver, driver, NULL);
    const char *triple = "-x86_64-unknown-linux-gnu-", *wrong = strstr(version, triple);
    if (!wrong || !strstr(version, " PoCL ") || strncmp(driver, "3.0", 3)) return "";
    wrong += strlen(triple); read_features(flags);
    int width = has_words(flags, "avx512f") ? 2 : has_words(flags, "avx");
    int known = has_words(with_avx512, wrong) ? 2 : has_words(with_avx, wrong);
    if (strcmp(wrong, "generic") && known == width) return "";
    for (size_t n = 0; n < sizeof processors / sizeof *processors; ++n)
        if (has_words(flags, processors[n][1]))
            return rename_processor(device, wrong, processors[n][0]) ? processors[n][0] : NULL;
    return NULL;
}
