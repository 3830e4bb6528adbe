/* Builds, runs, verifies and times the OpenCL kernels of a pack. README.md describes its format.
 * SPDX-License-Identifier: BSD-3-Clause */
#define CL_TARGET_OPENCL_VERSION 120
#define _DEFAULT_SOURCE
#include <CL/cl.h>
#include <float.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#ifdef __linux__
#include <sys/mman.h>
#endif

enum { WORD = 96, TEXT = 1024, MOST = 1 << 12, BEST_OF = 10, MOST_ROUNDS = 64, NONE = 3,
       LEAST_RUNS = 3, MOST_RUNS = 1000, PAGE = 4096, HUGE = 1 << 22, COPY = 0, FMA, LAUNCH, LOCAL, LIMITS };
static const char *const limit_names[LIMITS] = {"copy_gbps", "fma_gflops", "launch_us", "local_gbps"};
static const double GROSS = 1e-3; /* relative RMS error that no timed input reaches */

typedef struct { char file[2 * WORD]; int registers; cl_program made; char failed[TEXT]; } Program;
/* A launch; or, without a kernel, a copy: size is the first byte, the byte to copy to, and the number of bytes. */
typedef struct { cl_kernel kernel; cl_uint axes; size_t size[3], group[3], offset[3]; cl_mem from, to; } Step;
typedef struct { cl_mem buffers[MOST]; void *stores[MOST]; int buffer_count, step_count, is_judged; Step *steps;
                 size_t count; char type[8], answer_type[8], metric[8]; long place; double tolerance, floor; } Work;
typedef struct { char stage[WORD], form[WORD], title[TEXT], why[TEXT], size[WORD], hash[WORD]; long body;
                 int number, width, is_timed, is_limit, is_fp64; double bytes, operations; } Case;
typedef struct { const Case *timed; Work *work; char failed[2 * TEXT], worst[TEXT]; int skipped, cases, runs, ends[MOST_ROUNDS];
                 double max_error, tolerance, ratio, rms, *ms, *wall, at[MOST_ROUNDS]; } Row;
static Program *programs; static Case *cases; static Row *rows;
static int program_count, case_count, row_count;
static char folder[TEXT] = ".", options[2 * TEXT], pack_hash[WORD], failed[2 * TEXT];
static FILE *index_file, *data_file, *out, *json;
static cl_device_id device; static cl_context context; static cl_command_queue queue;
static int is_gpu, is_small, is_host, has_fp64, repeat = -1, round_count = 3;
static double build_s, seconds = 0.4, limits[LIMITS]; static const char *wanted_form, *processor = "";
const char *correct_processor(cl_device_id device); /* pocl.c */
static void die(const char *format, ...) {
    va_list args; va_start(args, format);
    fputs("runner: ", stderr); vfprintf(stderr, format, args); fputc('\n', stderr); va_end(args); exit(2);
}
static int ok(cl_int status, const char *what) {
    if (status != CL_SUCCESS) snprintf(failed, sizeof failed, "%s: OpenCL error %d", what, (int)status);
    return status == CL_SUCCESS;
}
static void *checked(void *memory) { if (!memory) die("out of memory"); return memory; }
static void *grow(void *list, int count, size_t each) {
    if (count && (count & (count - 1))) return list; /* full at powers of 2 */
    return checked(realloc(list, (count ? 2 * (size_t)count : 1) * each));
}
static double now(void) {
    struct timespec t;
#ifdef _WIN32
    timespec_get(&t, TIME_UTC);
#else
    clock_gettime(CLOCK_MONOTONIC, &t);
#endif
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}
static FILE *open_file(const char *name) {
    char path[2 * TEXT]; snprintf(path, sizeof path, "%s/%s", folder, name); FILE *file = fopen(path, "rb");
    if (!file) die("%s: cannot be read; give the folder of a pack", path);
    return file;
}
static void *read_data(void *values, long place, size_t bytes) {
    if (fseek(data_file, place, SEEK_SET) || fread(values, 1, bytes, data_file) != bytes)
        die("%s/data.bin: ends too early; unpack it again", folder);
    return values;
}
/* Strips the line's end; returns 0 at the end of the index. */
static int read_line(char *line, size_t size) {
    if (!fgets(line, (int)size, index_file)) return 0;
    line[strcspn(line, "\r\n")] = 0; return 1;
}
static int begins(const char *line, const char *word, const char **rest) {
    size_t n = strlen(word);
    if (strncmp(line, word, n) || (line[n] && line[n] != ' ')) return 0;
    *rest = line + n + (line[n] != 0); return 1;
}
/* Reads what there is; the bodies of cases are read again when they run. */
static void read_index(void) {
    char line[16 * TEXT], stage[WORD] = ""; const char *rest; Case *last = NULL;
    if (!read_line(line, sizeof line) || strcmp(line, "gpusim-pack 1"))
        die("%s/index.txt: is not \"gpusim-pack 1\"", folder);
    while (read_line(line, sizeof line)) {
        if (begins(line, "hash", &rest)) snprintf(pack_hash, sizeof pack_hash, "%s", rest);
        else if (begins(line, "options", &rest)) snprintf(options, TEXT, "%s", rest);
        else if (begins(line, "stage", &rest)) snprintf(stage, sizeof stage, "%s", rest);
        else if (begins(line, "program", &rest)) {
            programs = grow(programs, program_count, sizeof *programs);
            Program *p = memset(&programs[program_count++], 0, sizeof *p);
            sscanf(rest, "%191s %d", p->file, &p->registers);
        } else if (begins(line, "case", &rest) || begins(line, "limit", &rest)) {
            cases = grow(cases, case_count, sizeof *cases);
            last = memset(&cases[case_count++], 0, sizeof *last);
            last->is_limit = line[0] == 'l'; last->body = ftell(index_file);
            int used = 0; snprintf(last->stage, WORD, "%s", last->is_limit ? "" : stage);
            if (last->is_limit) sscanf(rest, "%95s %95s %lf %d", last->form, last->title, &last->bytes, &last->width);
            else if (sscanf(rest, "%95s %d %n", last->form, &last->number, &used))
                snprintf(last->title, TEXT, "%s", rest + used);
        } else if (last && begins(line, "fp64", &rest)) last->is_fp64 = 1;
        else if (last && begins(line, "why", &rest)) snprintf(last->why, TEXT, "%s", rest);
        else if (last && begins(line, "timed", &rest))
            last->is_timed = sscanf(rest, "%95s %lf %lf %95s", last->size, &last->bytes, &last->operations, last->hash) == 4;
    }
}
static cl_program build(int number) {
    Program *p = &programs[number]; char all[3 * TEXT], extensions[16 * TEXT] = ""; cl_int status;
    if (p->made || p->failed[0]) { snprintf(failed, sizeof failed, "%s", p->failed); return p->made; }
    FILE *file = open_file(p->file); fseek(file, 0, SEEK_END);
    size_t length = (size_t)ftell(file), log_length = 0; char *text = checked(malloc(length + 1)); rewind(file);
    if (fread(text, 1, length, file) != length) die("%s: cannot be read", p->file);
    fclose(file); clGetDeviceInfo(device, CL_DEVICE_EXTENSIONS, sizeof extensions - 1, extensions, NULL);
    int used = snprintf(all, sizeof all, "%s", options);
    if (p->registers && strstr(extensions, "cl_nv_compiler_options"))
        snprintf(all + used, sizeof all - (size_t)used, " -cl-nv-maxrregcount=%d", p->registers);
    double start = now(); char head[2 * WORD]; /* PoCL's cache does not know of the other processor */
    snprintf(head, sizeof head, *processor ? "typedef int built_for_%s;\n" : "%s", processor);
    for (char *at = head; *at; ++at) if (*at == '-') *at = '_';
    const char *texts[] = {head, text}; size_t lengths[] = {strlen(head), length};
    p->made = clCreateProgramWithSource(context, 2, texts, lengths, &status); free(text);
    if (!ok(status, "clCreateProgramWithSource")) return NULL;
    status = clBuildProgram(p->made, 1, &device, all, NULL, NULL); build_s += now() - start;
    if (status == CL_SUCCESS) return p->made;
    clGetProgramBuildInfo(p->made, device, CL_PROGRAM_BUILD_LOG, 0, NULL, &log_length);
    char *log = checked(calloc(log_length + 1, 1)), *cause;
    clGetProgramBuildInfo(p->made, device, CL_PROGRAM_BUILD_LOG, log_length, log, NULL);
    fprintf(stderr, "%s: cannot be built (OpenCL error %d) with %s\n%s\n", p->file, (int)status, all, log);
    cause = strstr(log, "error") ? strstr(log, "error") : log;
    snprintf(p->failed, TEXT, "%s: cannot be built: %.*s", p->file, (int)strcspn(cause, "\r\n"), cause);
    snprintf(failed, sizeof failed, "%s", p->failed); free(log); clReleaseProgram(p->made); p->made = NULL;
    return NULL;
}
/* Processors use whole pages of the host's memory in place, huge ones from 4 MiB on, as gpusim with NumPy does. */
static int add_buffer(Work *w, const char *line) {
    size_t bytes = 0; long place = -1; cl_int status; int n = w->buffer_count;
    if (sscanf(line, "%zu %ld", &bytes, &place) != 2 || n == MOST) die("index.txt: %s", line);
    char *store = w->stores[n] = checked(malloc(bytes + PAGE)), *values = store + PAGE - (size_t)store % PAGE;
#ifdef MADV_HUGEPAGE
    if (bytes >= HUGE) madvise(values, bytes, MADV_HUGEPAGE);
#endif
    if (place < 0) memset(values, 0xff, bytes); else read_data(values, place, bytes); /* NaN: reading it is found */
    w->buffers[n] = clCreateBuffer(context, is_host ? CL_MEM_USE_HOST_PTR : CL_MEM_COPY_HOST_PTR, bytes, values, &status);
    if (!is_host) { free(store); w->stores[n] = NULL; }
    w->buffer_count += 1; return ok(status, "clCreateBuffer");
}
static int add_run(Work *w, char *line) {
    char *word = strtok(line, " "); int program = atoi(word); char *name = strtok(NULL, " ");
    if (program < 0 || program >= program_count || !name) die("index.txt: run %s", line);
    Step step; memset(&step, 0, sizeof step); step.axes = (cl_uint)atoi(strtok(NULL, " "));
    size_t *dims[] = {step.size, step.group, step.offset};
    for (int d = 0; d < 3; ++d)
        for (cl_uint a = 0; a < step.axes; ++a) dims[d][a] = (size_t)strtoul(strtok(NULL, " "), NULL, 10);
    cl_program built = build(program); cl_int status;
    step.kernel = built ? clCreateKernel(built, name, &status) : NULL;
    if (!built || !ok(status, name)) return 0;
    w->steps = grow(w->steps, w->step_count, sizeof step); w->steps[w->step_count++] = step;
    int count = atoi(strtok(NULL, " "));
    for (int i = 0; i < count; ++i) {
        word = strtok(NULL, " ");
        cl_int whole = (cl_int)strtol(word + 1, NULL, 10); cl_float real = (cl_float)strtod(word + 1, NULL);
        if (*word == 'b' && (whole < 0 || whole >= w->buffer_count)) die("index.txt: no buffer %s of %s", word, name);
        if (*word == 'b') status = clSetKernelArg(step.kernel, (cl_uint)i, sizeof(cl_mem), &w->buffers[whole]);
        else if (*word == 'i') status = clSetKernelArg(step.kernel, (cl_uint)i, sizeof whole, &whole);
        else status = clSetKernelArg(step.kernel, (cl_uint)i, sizeof real, &real);
        if (!ok(status, name)) return 0;
    }
    return 1;
}
static void end_work(Work *w) {
    clFinish(queue);
    for (int i = 0; w && i < w->buffer_count; free(w->stores[i++])) if (w->buffers[i]) clReleaseMemObject(w->buffers[i]);
    for (int i = 0; w && i < w->step_count; ++i) if (w->steps[i].kernel) clReleaseKernel(w->steps[i].kernel);
    if (w) free(w->steps);
    free(w);
}
/* Builds kernels, fills buffers and sets arguments; NULL if that fails. */
static Work *begin_work(const Case *c) {
    Work *w = checked(calloc(1, sizeof *w)); char line[16 * TEXT]; const char *rest; int good = 1;
    fseek(index_file, c->body, SEEK_SET); failed[0] = 0;
    while (good && read_line(line, sizeof line) && strcmp(line, "end")) {
        if (begins(line, "buffer", &rest)) good = add_buffer(w, rest);
        else if (begins(line, "run", &rest)) good = add_run(w, line + (rest - line));
        else if (begins(line, "copy", &rest)) {
            int from, to; Step step; memset(&step, 0, sizeof step);
            sscanf(rest, "%d %zu %d %zu %zu", &from, &step.size[0], &to, &step.size[1], &step.size[2]);
            step.from = w->buffers[from]; step.to = w->buffers[to];
            w->steps = grow(w->steps, w->step_count, sizeof step); w->steps[w->step_count++] = step;
        } else if (begins(line, "judge", &rest))
            w->is_judged = sscanf(rest, "%7s %zu %7s %ld %7s %lf %lf", w->type, &w->count, w->answer_type,
                                  &w->place, w->metric, &w->tolerance, &w->floor) == 7;
    }
    if (!good) { end_work(w); w = NULL; }
    return w;
}
/* Runs all steps; returns 0 on failure. Times: of the device's clock, and of the host's [ms]. */
static int run_work(Work *w, double *ms, double *wall) {
    cl_event *events = checked(calloc((size_t)w->step_count + 1, sizeof *events));
    int done = 0, good = 1; double start = now();
    for (; good && done < w->step_count; done += good) {
        Step *s = &w->steps[done];
        cl_int status = s->kernel
            ? clEnqueueNDRangeKernel(queue, s->kernel, s->axes, s->offset, s->size, s->group, 0, NULL, &events[done])
            : clEnqueueCopyBuffer(queue, s->from, s->to, s->size[0], s->size[1], s->size[2], 0, NULL, &events[done]);
        good = ok(status, s->kernel ? "clEnqueueNDRangeKernel" : "clEnqueueCopyBuffer");
    }
    good = ok(clFinish(queue), "clFinish") && good;
    *wall = 1e3 * (now() - start); *ms = 0;
    for (int i = 0; i < done; ++i) {
        cl_ulong first = 0, last = 0; cl_int status = CL_SUCCESS;
        clGetEventProfilingInfo(events[i], CL_PROFILING_COMMAND_START, sizeof first, &first, NULL);
        clGetEventProfilingInfo(events[i], CL_PROFILING_COMMAND_END, sizeof last, &last, NULL);
        clGetEventInfo(events[i], CL_EVENT_COMMAND_EXECUTION_STATUS, sizeof status, &status, NULL);
        if (status < 0) good = ok(status, "a kernel ended with an error");
        *ms += 1e-6 * (double)(last - first); clReleaseEvent(events[i]);
    }
    free(events); return good;
}
static double value_of(const char *type, const void *values, size_t i) {
#define TYPE(name, c_type) if (!strcmp(type, name)) return (double)((const c_type *)values)[i];
    TYPE("f4", cl_float) TYPE("f8", cl_double) TYPE("u1", cl_uchar) TYPE("u2", cl_ushort) TYPE("u4", cl_uint)
    TYPE("i1", cl_char) TYPE("i2", cl_short) TYPE("i4", cl_int) TYPE("b1", cl_uchar)
    die("index.txt: unknown type %s", type); return 0;
}
/* The largest error in the case's metric; equal values, also infinite ones, and two NaN have none. */
static int judge(const Work *w, double *error, double *rms) {
    size_t bytes = w->count * (size_t)(w->type[1] - '0');
    size_t answer = w->count * (size_t)(w->answer_type[1] - '0');
    void *right = read_data(checked(malloc(answer + 1)), w->place, answer), *found = checked(malloc(bytes + 1));
    double largest = 0, local = 0, peak = 0, squares = 0, all = 0;
    int good = !bytes || ok(clEnqueueReadBuffer(queue, w->buffers[0], CL_TRUE, 0, bytes, found, 0, NULL, NULL),
                            "clEnqueueReadBuffer");
    for (size_t i = 0; good && i < w->count; ++i) {
        double a = value_of(w->type, found, i), b = value_of(w->answer_type, right, i);
        if (isnan(a) && isnan(b)) continue;
        double difference = a == b ? 0 : fabs(a - b), size = isnan(b) ? 0 : fabs(b);
        if (isnan(difference)) difference = INFINITY;
        peak = fmax(peak, size); largest = fmax(largest, difference);
        local = fmax(local, isinf(difference) ? INFINITY : difference / fmax(fmax(size, w->floor), DBL_MIN));
        squares += difference * difference; all += size * size;
    }
    free(found); free(right);
    *rms = all > 0 ? sqrt(squares / all) : squares > 0 ? INFINITY : 0;
    *error = !strcmp(w->metric, "exact") ? largest : !strcmp(w->metric, "local") ? local
           : !strcmp(w->metric, "rms") ? *rms : isinf(largest) ? largest : largest / fmax(peak, DBL_MIN);
    return good;
}
/* The place of a case's form among those that the device takes, the best first; NONE if it takes it not. */
static int rank(const Case *c) {
    static const char *const forms[][3] = {{"cpu", "gpu", "small"}, {"gpu", "small", ""}, {"small", "gpu", ""}};
    for (int n = 0; n < NONE; ++n)
        if (!strcmp(forms[is_gpu + (is_gpu && is_small)][n], c->form)) return n;
    return NONE;
}
static int is_chosen(const Case *c) {
    if (c->is_limit) return 0;
    if (wanted_form) return !strcmp(c->form, wanted_form);
    for (const Case *o = cases; o < cases + case_count; ++o)
        if (!o->is_limit && o->number == c->number && !strcmp(o->stage, c->stage) && rank(o) < rank(c)) return 0;
    return rank(c) != NONE;
}
/* Runs a case once and judges it; the work of the timed input stays. */
static void verify(Row *row, const Case *c) {
    double error = 0, rms = NAN, ms, wall, ratio; if (c->is_fp64 && !has_fp64) { row->skipped += 1; return; }
    Work *w = begin_work(c); int good = w && run_work(w, &ms, &wall) && (!w->is_judged || judge(w, &error, &rms));
    double tolerance = w && !strcmp(w->metric, "rms") ? GROSS : w ? w->tolerance : 0;
    row->cases += good && w->is_judged; ratio = error / (tolerance > 0 ? tolerance : 1);
    if (good && !(error <= tolerance))
        snprintf(failed, sizeof failed, "error %.3g, tolerance %.3g (%.1000s)", error, tolerance, c->why);
    if (!good || !(error <= tolerance)) {
        fprintf(out, "     wrong: %s/%d, %s form: %.500s: %s\n", c->stage, c->number, c->form, c->title, failed);
        if (!row->failed[0]) snprintf(row->failed, sizeof row->failed, "%.500s: %.1400s", c->title, failed);
    } else if (!c->is_timed && (!row->worst[0] || ratio > row->ratio)) {
        row->max_error = error; row->tolerance = tolerance; row->ratio = ratio;
        snprintf(row->worst, TEXT, "%s", c->title);
    }
    if (c->is_timed) row->rms = rms;
    if (c->is_timed && good) row->work = w; else end_work(w);
}
static int is_asked(const Case *c, const char *only) {
    char line[16 * TEXT], kernel[2 * WORD], numbered[2 * WORD]; const char *rest; int found = 0, n;
    snprintf(numbered, sizeof numbered, "%s/%d", c->stage, c->number);
    if (!only || !strcmp(only, c->stage) || !strcmp(only, numbered) || (c->is_timed && !strcmp(only, "timed"))) return 1;
    fseek(index_file, c->body, SEEK_SET);
    while (!found && read_line(line, sizeof line) && strcmp(line, "end"))
        found = begins(line, "run", &rest) && sscanf(rest, "%d %191s", &n, kernel) == 2 && !strcmp(kernel, only);
    return found;
}
static void verify_all(const char *only) {
    for (int i = 0; i < case_count; ++i) {
        if (!is_chosen(&cases[i]) || !is_asked(&cases[i], only)) continue;
        Row *row = row_count ? &rows[row_count - 1] : NULL;
        if (!row || strcmp(row->timed->stage, cases[i].stage)) {
            for (int p = 0; p < program_count; ++p)
                if (programs[p].made) { clReleaseProgram(programs[p].made); programs[p].made = NULL; }
            rows = grow(rows, row_count, sizeof *rows);
            row = memset(&rows[row_count++], 0, sizeof *rows); row->rms = NAN; row->timed = &cases[i];
            fprintf(stderr, "%s\n", cases[i].stage); /* the last one, if the driver crashes */
        }
        if (cases[i].is_timed) row->timed = &cases[i];
        verify(row, &cases[i]);
    }
}
static int by_size(const void *a, const void *b) { double x = *(const double *)a, y = *(const double *)b; return (x > y) - (x < y); }
/* As numpy.percentile. */
static double quantile(const double *values, int count, double share) {
    size_t bytes = (size_t)count * sizeof *values; double *sorted = checked(malloc(bytes)), at = share * (count - 1);
    int i = (int)at; memcpy(sorted, values, bytes); qsort(sorted, (size_t)count, sizeof *sorted, by_size);
    double found = sorted[i] + (at - i) * (sorted[i + 1 < count ? i + 1 : i] - sorted[i]);
    free(sorted); return found;
}
/* As gpusim/bench/suite.py: a GPU's clock goes up before, and a row has LEAST_RUNS if it is not slow. */
static void time_all(void) {
    for (int r = 0; r < round_count && repeat; ++r)
        for (Row *row = rows; row < rows + row_count; ++row) {
            int good = row->work && !row->failed[0]; double ms, wall, begun = now(), start;
            while (good && is_gpu && now() < begun + seconds / 4) good = run_work(row->work, &ms, &wall);
            row->at[r] = (double)time(NULL); begun = now();
            for (int n = 1; good && n <= (repeat > 0 ? repeat : MOST_RUNS); ++n) {
                start = now(); good = run_work(row->work, &ms, &wall);
                row->ms = grow(row->ms, row->runs, sizeof ms); row->wall = grow(row->wall, row->runs, sizeof wall);
                row->ms[row->runs] = ms; row->wall[row->runs++] = wall;
                if (repeat < 0 && now() - begun >= seconds && (n >= LEAST_RUNS || now() - start > seconds)) break;
            }
            row->ends[r] = row->runs;
            if (!good && !row->failed[0]) snprintf(row->failed, sizeof row->failed, "%s", failed);
        }
}
/* The best of all widths and repetitions: a rate, or a time [us]; NAN if it cannot be measured. */
static double measure_limit(const char *name) {
    double best = NAN; char version[TEXT] = ""; cl_uint width = 1;
    clGetDeviceInfo(device, CL_DRIVER_VERSION, sizeof version, version, NULL);
    clGetDeviceInfo(device, CL_DEVICE_NATIVE_VECTOR_WIDTH_FLOAT, sizeof width, &width, NULL);
    int is_old = strchr("12", version[0]) || !strncmp(version, "3.0", 3); /* PoCL < 3.1 aborts at 16 */
    for (const Case *c = cases; c < cases + case_count; ++c) {
        if (!c->is_limit || strcmp(c->title, name) || strcmp(c->form, is_gpu ? "gpu" : "cpu")) continue;
        if (c->width > 8 && (width < 16 || is_old)) continue;
        Work *w = begin_work(c); double ms, wall;
        for (int n = 0; w && n < BEST_OF && run_work(w, &ms, &wall); ++n) {
            double found = strcmp(name, "launch_us") ? c->bytes / ms / 1e6 : 1e3 * ms;
            if (ms > 0 && !(strcmp(name, "launch_us") ? found <= best : found >= best)) best = found;
        }
        end_work(w);
    }
    return best;
}
static void put_text(const char *key, const char *text) {
    fprintf(json, "\"%s\": \"", key);
    for (; *text; ++text) fprintf(json, strchr("\"\\", *text) ? "\\%c" : "%c", (unsigned char)*text < 32 ? ' ' : *text);
    fputs("\", ", json);
}
static void put(const char *k, double v) { fprintf(json, isfinite(v) ? "\"%s\": %.15g, " : "\"%s\": null, ", k, v); }
static void put_row(const Row *row, double *attained) {
    static const char *const names[] = {"wall_ms_best", "wall_ms_p20", "wall_ms_p50", "wall_ms_p80"};
    static const char *const bounds[] = {"memory", "arithmetic", "launches"}; static const double shares[] = {0, 0.2, 0.5, 0.8};
    const Case *c = row->timed; int count = row->runs; char text[4 * WORD], form[2 * WORD] = "";
    if (strcmp(c->form, "cpu") ? !is_gpu : is_gpu) snprintf(form, sizeof form, " (%s form)", c->form);
    snprintf(text, sizeof text, "%.95s %.95s%.120s", c->stage, c->size, form); *attained = NAN;
    fputs("  {", json); put_text("name", text); put_text("kind", "stage");
    snprintf(text, sizeof text, "%.*s", (int)strcspn(c->stage, "."), c->stage); put_text("family", text);
    put_text("size", c->size); put_text("hash", c->hash); put("cases", row->cases); put("skipped", row->skipped);
    fprintf(json, "\"verified\": %s, ", row->failed[0] ? "false" : "true");
    if (row->failed[0]) put_text("failed", row->failed); else {
        put("rel_rms_error", row->rms); put_text("case", row->worst);
        put("max_error", row->max_error); put("tolerance", row->tolerance);
    }
    if (!row->failed[0] && row->ms) {
        fputs("\"rounds\": [", json);
        for (int n = 0, r = 0; r < round_count; ++r) {
            fprintf(json, "%s{\"at\": %.0f, \"ms\": [", r ? ", " : "", row->at[r]);
            for (; n < row->ends[r]; ++n) fprintf(json, "%.6g%s", row->ms[n], n + 1 < row->ends[r] ? ", " : "]}");
        }
        fputs("], ", json);
        for (int n = 0; n < 4; ++n) put(names[n] + 5, quantile(row->ms, count, shares[n]));
        for (int n = 0; n < 4; ++n) put(names[n], quantile(row->wall, count, shares[n]));
        double parts[] = {c->bytes / limits[COPY] / 1e6, fmax(c->operations, 0) / limits[FMA] / 1e6,
                          row->work->step_count * limits[LAUNCH] / 1e3}; int bound = 0;
        for (int n = 1; n < 3; ++n) if (parts[n] > parts[bound]) bound = n;
        *attained = parts[bound] / quantile(row->ms, count, 0.5);
        put("bytes", c->bytes); put("operations", c->operations < 0 ? NAN : c->operations);
        put("launches", row->work->step_count); put("floor_ms", parts[bound]); put_text("bound", bounds[bound]);
        put("attained", *attained);
    }
    fprintf(json, "\"form\": \"%s\"}", c->form);
}
static void write_json(const char *path, const char *name, const char *driver) {
    char date[WORD], scores[16 * TEXT] = "", *end = scores, next[TEXT + 2]; time_t t = time(NULL);
    double logs = 0, all = 0, attained; int is_file = strcmp(path, "-");
    snprintf(next, sizeof next, "%.1000s~", path); /* complete or absent */
    json = is_file ? fopen(next, "w") : stdout; if (!json) die("%s: cannot be written", path);
    strftime(date, sizeof date, "%Y-%m-%dT%H:%M:%S+00:00", gmtime(&t));
    fputs("{\"bench\": \"suite\", \"format\": 1, ", json); put_text("device", name); fputs("\n \"machine\": {", json);
    put_text("device", name); put_text("driver", driver); put_text("flags", options);
    fputs("\"runner\": \"C\", \"warnings\": []},\n \"commit\": null, \"dirty\": null, ", json);
    put_text("date", date); put_text("hash", pack_hash); fputs("\n \"limits\": {", json);
    for (int n = 0; n < LIMITS; ++n) put(limit_names[n], limits[n]);
    fputs("\"upload_gbps\": null, \"download_gbps\": null},\n \"cold_build_s\": null, \"quick\": false, ", json);
    put("build_s", build_s); fputs("\n \"rows\": [\n", json);
    for (int i = 0, members = 0; i < row_count; ++i) {
        const char *stage = rows[i].timed->stage; size_t n = strcspn(stage, ".");
        put_row(&rows[i], &attained); fputs(i + 1 < row_count ? ",\n" : "\n", json);
        if (attained > 1) attained = 1; /* from a cache: it must not make up for a slow row */
        logs += log(attained); all += log(attained); ++members;
        if (i + 1 < row_count && !strncmp(stage, rows[i + 1].timed->stage, n + 1)) continue;
        end += sprintf(end, isnan(logs) ? "\"%.*s\": null, " : "\"%.*s\": %.6g, ", (int)n, stage, exp(logs / members));
        logs = 0; members = 0;
    }
    fprintf(json, " ],\n \"scores\": {%s", scores);
    fprintf(json, isnan(all) ? "\"all\": null}}\n" : "\"all\": %.6g}}\n", exp(all / row_count));
    if (is_file) {
        int is_bad = ferror(json); is_bad = fclose(json) || is_bad; remove(path);
        if (is_bad || rename(next, path)) die("%s: cannot be written", path);
    }
}
static void show_row(const Row *row) {
    const Case *c = row->timed; int count = row->runs;
    if (row->failed[0]) { fprintf(out, "FAIL %-22s %s\n", c->stage, row->failed); return; }
    fprintf(out, "ok   %-22s %-5s %3d cases", c->stage, c->form, row->cases);
    if (row->skipped) fprintf(out, ", %d skipped (no fp64)", row->skipped);
    if (row->ms) fprintf(out, ", %s: %.4f ms (%.4f .. %.4f), wall %.4f ms", c->size, quantile(row->ms, count, 0.5),
                         quantile(row->ms, count, 0.2), quantile(row->ms, count, 0.8), quantile(row->wall, count, 0.5));
    fputc('\n', out);
}
/* Opens device number `wanted`, counted through all platforms; -1 lists all. */
static void open_device(int wanted, char *name, char *driver) {
    cl_platform_id platforms[64]; cl_device_id found[64]; cl_uint platform_count = 0, count; int number = 0;
    if (clGetPlatformIDs(64, platforms, &platform_count) != CL_SUCCESS) platform_count = 0;
    for (cl_uint p = 0; p < platform_count && p < 64; ++p) {
        if (clGetDeviceIDs(platforms[p], CL_DEVICE_TYPE_ALL, 64, found, &count) != CL_SUCCESS) continue;
        for (cl_uint d = 0; d < count && d < 64; ++d, ++number) {
            char platform[TEXT] = "", version[TEXT] = "", build_of[TEXT] = "";
            clGetDeviceInfo(found[d], CL_DEVICE_NAME, TEXT, name, NULL);
            clGetDeviceInfo(found[d], CL_DEVICE_VERSION, TEXT, version, NULL);
            clGetDeviceInfo(found[d], CL_DRIVER_VERSION, TEXT, build_of, NULL);
            clGetPlatformInfo(platforms[p], CL_PLATFORM_NAME, TEXT, platform, NULL);
            snprintf(driver, TEXT, "%.90s %.90s (%.800s)", platform, build_of, version); device = found[d];
            if (wanted < 0) printf("device %d: %s; %s\n", number, name, driver);
            if (number == wanted) return;
        }
    }
    if (wanted >= 0) die("no OpenCL device %d, there are %d; see README.md", wanted, number);
}
static void prepare(int wanted, char *name, char *driver) {
#define ASK(key, value) clGetDeviceInfo(device, CL_DEVICE_##key, sizeof value, &value, NULL)
    cl_int status; cl_device_type type = 0; size_t group = 0; cl_ulong local = 0; cl_device_fp_config fp64 = 0;
    cl_bool shared = 0; open_device(wanted, name, driver); const char *corrected = correct_processor(device);
    if (corrected) processor = corrected;
    else if (!wanted_form || !strcmp(wanted_form, "cpu"))
        die("%s: takes this processor for another one, and its vectors are wrong; use --form gpu", driver);
    if (*processor) snprintf(driver + strlen(driver), TEXT - strlen(driver), ", corrected to %s", processor);
    ASK(TYPE, type); ASK(MAX_WORK_GROUP_SIZE, group); ASK(LOCAL_MEM_SIZE, local);
    ASK(DOUBLE_FP_CONFIG, fp64); ASK(HOST_UNIFIED_MEMORY, shared);
    has_fp64 = fp64 != 0; is_gpu = (type & (CL_DEVICE_TYPE_GPU | CL_DEVICE_TYPE_CPU)) == CL_DEVICE_TYPE_GPU;
    is_host = !is_gpu && shared; is_small = group < 1024 || local < 48 << 10;
    context = clCreateContext(NULL, 1, &device, NULL, NULL, &status);
    if (ok(status, "clCreateContext")) queue = clCreateCommandQueue(context, device, CL_QUEUE_PROFILING_ENABLE, &status);
    if (!ok(status, "clCreateCommandQueue")) die("%s", failed);
    fprintf(out, "%s; %s\n", name, driver);
}
int main(int argc, char **argv) {
    const char *only = NULL, *path = NULL, *more = ""; char name[TEXT] = "", driver[TEXT] = "", *rest;
    int wanted = 0, is_list = 0, wrong = 0; const cl_uint one = 1;
    if (*(const unsigned char *)&one != 1) die("packs are for little-endian machines");
    for (int i = 1; i < argc; ++i) {
        const char *key = argv[i], *value = i + 1 < argc ? argv[i + 1] : "";
        long number = strtol(value, &rest, 10); int is_number = *value && !*rest && number >= 0 && number < 100000;
        if (strncmp(key, "--", 2)) { snprintf(folder, sizeof folder, "%s", key); continue; }
        if (!strcmp(key, "--list")) { is_list = 1; continue; } else ++i;
        if (!strcmp(key, "--only") && *value) only = value; else if (!strcmp(key, "--json") && *value) path = value;
        else if (!strcmp(key, "--build-options")) more = value;
        else if (!strcmp(key, "--form") && (!strcmp(value, "cpu") || !strcmp(value, "gpu") || !strcmp(value, "small")))
            wanted_form = value;
        else if (!strcmp(key, "--device") && is_number) wanted = (int)number;
        else if (!strcmp(key, "--repeat") && is_number) repeat = (int)number;
        else if (!strcmp(key, "--seconds") && *value && (seconds = strtod(value, &rest)) > 0 && !*rest) repeat = -1;
        else if (!strcmp(key, "--rounds") && is_number && number && number <= MOST_ROUNDS) round_count = (int)number;
        else die("%s %s: wanted runner [FOLDER] [--list] [--device K] [--only STAGE|STAGE/CASE|KERNEL|timed]\n  [--repeat N]"
                 " [--seconds S] [--rounds N] [--form cpu|gpu|small] [--build-options TEXT] [--json FILE]: README.md", key, value);
    }
    index_file = open_file("index.txt"); data_file = open_file("data.bin"); read_index();
    out = path && !strcmp(path, "-") ? stderr : stdout;
    if (is_list) {
        open_device(-1, name, driver);
        for (const Case *c = cases; c < cases + case_count; ++c)
            if (!c->is_limit && (c == cases || strcmp(c->stage, c[-1].stage))) puts(c->stage);
        return 0;
    }
    snprintf(options + strlen(options), sizeof options - strlen(options), " %s", more);
    prepare(wanted, name, driver); verify_all(only);
    if (!row_count) die("%s: nothing has this name, or this form; --list shows the stages", only ? only : "--form");
    time_all();
    for (int i = 0; i < row_count; ++i) { show_row(&rows[i]); wrong += rows[i].failed[0] != 0; }
    fprintf(out, "%d passed, %d failed\n", row_count - wrong, wrong);
    for (int n = 0; n < LIMITS && path; ++n) limits[n] = repeat ? measure_limit(limit_names[n]) : NAN;
    if (path) write_json(path, name, driver);
    for (int i = 0; i < row_count; ++i) { end_work(rows[i].work); free(rows[i].ms); free(rows[i].wall); }
    clReleaseCommandQueue(queue); clReleaseContext(context);
    return wrong ? 1 : 0;
}
