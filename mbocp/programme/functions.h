/* What functions need that the kernel writes in C, see `_native/kernel/c_source.hpp`; included after lanes.h. */
#include <stdint.h>

#define casadi_int long long
#define CASADI_SYMBOL_EXPORT __attribute__((visibility("default")))
typedef mbocp_lanes V;

#define mbocp_multiply_subtract(x, y, z) mbocp_multiply_add(x, y, -(z))
#define mbocp_subtract_product(x, y, z) mbocp_multiply_add(-(x), y, z)

#if MBOCP_LANES == 1
#define mbocp_lane(x, i) (*(x))
#else
#define mbocp_lane(x, i) ((*(x))[i])
#endif

static inline __attribute__((unused)) int mbocp_any(V x) {
  int i, any = 0;
  for (i = 0; i < MBOCP_LANES; ++i) any |= mbocp_lane(&x, i) != 0;
  return any;
}

static __attribute__((unused, noinline)) void mbocp_zero(V* to, int count) {
  int i;
  for (i = 0; i < count; ++i) to[i] = mbocp_all(0.);
}

static __attribute__((unused, noinline)) void mbocp_copy(V* to, const V* from, int count) {
  int i;
  for (i = 0; i < count; ++i) to[i] = from[i];
}

/* Where column `which` of a table is, beyond whose ends are no numbers; it is put into `to` where lanes choose apart. */
static __attribute__((unused, noinline)) const V* mbocp_choose_column(V* to, const V* table, int rows, int columns,
                                                                      V which) {
  int i, row;
  for (i = 0; i < MBOCP_LANES; ++i) {
    const double number = mbocp_lane(&which, i);
    const int is_there = number >= 0 && number < columns;
    const V* column = table + (is_there ? rows * (int)number : 0);
    if (i == 0 && is_there && mbocp_agree(which)) return column;
    for (row = 0; row < rows; ++row) mbocp_lane(to + row, i) = is_there ? mbocp_lane(column + row, i) : 0. / 0.;
  }
  return to;
}

static __attribute__((unused, noinline)) void mbocp_add_chosen(V* row, int count, V which, V share) {
  const double first = mbocp_first(which);
  int i;
  if (first >= 0 && first < count && mbocp_agree(which)) {
    row[(int)first] += share;
    return;
  }
  for (i = 0; i < MBOCP_LANES; ++i) {
    const double number = mbocp_lane(&which, i);
    if (number >= 0 && number < count) mbocp_lane(row + (int)number, i) += mbocp_lane(&share, i);
  }
}

/* The first place of work arrays at which a number of each lane may stand. */
static inline __attribute__((unused)) V* mbocp_first_place(double* w) {
  return (V*)(((uintptr_t)w + sizeof(V) - 1) / sizeof(V) * sizeof(V));
}

MBOCP_EACH(exp)
MBOCP_EACH(log)
MBOCP_EACH(tan)
MBOCP_EACH(asin)
MBOCP_EACH(acos)
MBOCP_EACH(atan)
MBOCP_EACH(sinh)
MBOCP_EACH(cosh)
MBOCP_EACH(tanh)
MBOCP_EACH(asinh)
MBOCP_EACH(acosh)
MBOCP_EACH(atanh)
MBOCP_EACH(floor)
MBOCP_EACH(ceil)
MBOCP_EACH(erf)
MBOCP_EACH(log1p)
MBOCP_EACH(expm1)
MBOCP_EACH_OF_TWO(pow)
MBOCP_EACH_OF_TWO(fmod)
MBOCP_EACH_OF_TWO(remainder)
MBOCP_EACH_OF_TWO(atan2)
MBOCP_EACH_OF_TWO(hypot)
MBOCP_EACH_OF_TWO(copysign)
