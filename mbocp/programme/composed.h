/* What functions that call others in lanes need, see composed.py; included after lanes.h. */
#include <stddef.h>

typedef int (*mbocp_function)(const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem);
typedef const casadi_int* (*mbocp_sparsity)(casadi_int i);

static inline __attribute__((unused)) mbocp_lanes mbocp_wide_floor(mbocp_lanes x) {
#if MBOCP_LANES == 1
  return floor(x);
#else
  int i;
  for (i = 0; i < MBOCP_LANES; ++i) x[i] = floor(x[i]);
  return x;
#endif
}

static __attribute__((unused)) void mbocp_wide_clear(mbocp_lanes* x, casadi_int n) {
  casadi_int i;
  if (x)
    for (i = 0; i < n; ++i) x[i] = mbocp_all(0.);
}

static __attribute__((unused)) void mbocp_wide_copy(const mbocp_lanes* x, casadi_int n, mbocp_lanes* y) {
  casadi_int i;
  if (!y) return;
  if (!x) mbocp_wide_clear(y, n);
  else
    for (i = 0; i < n; ++i) y[i] = x[i];
}

/* Numbers of a matrix to those of its transposed one, patterns as CasADi has them. */
static __attribute__((unused)) void mbocp_wide_trans(const mbocp_lanes* x, const casadi_int* sp_x, mbocp_lanes* y,
                                                     const casadi_int* sp_y, casadi_int* next) {
  const casadi_int columns = sp_x[1], count = sp_x[2 + columns], *row = sp_x + 3 + columns;
  casadi_int k;
  for (k = 0; k < sp_y[1]; ++k) next[k] = sp_y[2 + k];
  for (k = 0; k < count; ++k) y[next[row[k]]++] = x[k];
}

static casadi_int mbocp_count(const casadi_int* sparsity) {
  return sparsity[2] == 1 ? sparsity[0] * sparsity[1] : sparsity[2 + sparsity[1]];
}

/* A function lane by lane; inputs and outputs are numbers for each lane, and `room` is large enough for the function. */
static __attribute__((unused, noinline)) int mbocp_one_by_one(mbocp_function function, mbocp_sparsity of_input,
                                                              mbocp_sparsity of_output, casadi_int num_in,
                                                              casadi_int num_out, int sz_arg, int sz_res,
                                                              const casadi_real** arg, casadi_real** res, casadi_int* iw,
                                                              casadi_real* room) {
  casadi_int i, k, total = 1;
  int lane, failed = 0;
  for (i = 0; i < num_in; ++i) total += mbocp_count(of_input(i));
  for (i = 0; i < num_out; ++i) total += mbocp_count(of_output(i));
  for (lane = 0; lane < MBOCP_LANES; ++lane) {
    casadi_real numbers[total], *next = numbers, *y[sz_res];
    const casadi_real* x[sz_arg];
    for (i = 0; i < num_in; ++i) {
      const casadi_int count = mbocp_count(of_input(i));
      x[i] = arg[i] ? next : 0;
      for (k = 0; arg[i] && k < count; ++k) next[k] = arg[i][k * MBOCP_LANES + lane];
      next += count;
    }
    for (i = 0; i < num_out; ++i) y[i] = res[i] ? next : 0, next += mbocp_count(of_output(i));
    failed |= function(x, y, iw, room, 0);
    for (i = 0; i < num_out; ++i) {
      const casadi_int count = mbocp_count(of_output(i));
      for (k = 0; res[i] && k < count; ++k) res[i][k * MBOCP_LANES + lane] = y[i][k];
    }
  }
  return failed;
}
