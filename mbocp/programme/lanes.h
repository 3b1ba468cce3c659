/* Several stages at once: numbers of as many stages as a vector register holds, in its lanes.

Included by the C of `c_files.py`, which defines MBOCP_LANES, and by the kernel's tapes. A condition is 1.0 or 0.0, as in C, and what it
does not choose is 0: lanes never meet. Compilers and processors that are not known get one lane. */
#if !(defined(__GNUC__) && (defined(__AVX2__) || defined(__aarch64__)))
#undef MBOCP_LANES
#define MBOCP_LANES 1
#endif

/* Products within sums are rounded once where they are said to be, and nowhere else: compilers must not choose. */
#if defined(__FMA__) || defined(__ARM_FEATURE_FMA)
#define mbocp_one_multiply_add(x, y, z) __builtin_fma(x, y, z)
#else
#define mbocp_one_multiply_add(x, y, z) ((x) * (y) + (z))
#endif

#if MBOCP_LANES == 1
typedef double mbocp_lanes;
#define mbocp_multiply_add(x, y, z) mbocp_one_multiply_add(x, y, z)
#define mbocp_all(x) (x)
#define mbocp_first(x) (x)
#define mbocp_agree(x) ((x) == (x))
#define mbocp_less(x, y) ((x) < (y))
#define mbocp_at_most(x, y) ((x) <= (y))
#define mbocp_equal(x, y) ((x) == (y))
#define mbocp_unequal(x, y) ((x) != (y))
#define mbocp_and(x, y) ((x) && (y))
#define mbocp_or(x, y) ((x) || (y))
#define mbocp_not(x) (!(x))
#define mbocp_if(x, y) ((x) ? (y) : 0)
#define mbocp_fabs(x) fabs(x)
#define mbocp_fmin(x, y) fmin(x, y)
#define mbocp_fmax(x, y) fmax(x, y)
#define mbocp_sign(x) ((x) < 0 ? -1 : (x) > 0 ? 1 : (x))
#define mbocp_sqrt(x) sqrt(x)
#define mbocp_sin(x) sin(x)
#define mbocp_cos(x) cos(x)
#define mbocp_sin_and_cos(x, other) (*(other) = cos(x), sin(x))
#define mbocp_cos_and_sin(x, other) (*(other) = sin(x), cos(x))
#define MBOCP_EACH(f) static double mbocp_each_##f(double x) { return f(x); }
#define MBOCP_EACH_OF_TWO(f) static double mbocp_each_##f(double x, double y) { return f(x, y); }
#else
typedef double mbocp_lanes __attribute__((vector_size(8 * MBOCP_LANES), may_alias));
typedef long long mbocp_bits __attribute__((vector_size(8 * MBOCP_LANES)));
#if MBOCP_LANES == 4
#define mbocp_all(x) ((mbocp_lanes){(x), (x), (x), (x)})
#define mbocp_all_bits(x) ((mbocp_bits){(x), (x), (x), (x)})
#else
#define mbocp_all(x) ((mbocp_lanes){(x), (x), (x), (x), (x), (x), (x), (x)})
#define mbocp_all_bits(x) ((mbocp_bits){(x), (x), (x), (x), (x), (x), (x), (x)})
#endif
#define mbocp_first(x) ((x)[0])
#if !defined(__FMA__) && !defined(__ARM_FEATURE_FMA)
#define mbocp_multiply_add(x, y, z) ((x) * (y) + (z))
#elif defined(__clang__)
static inline __attribute__((unused)) mbocp_lanes mbocp_multiply_add(mbocp_lanes x, mbocp_lanes y, mbocp_lanes z) {
#pragma clang fp contract(on)
  return x * y + z;
}
#elif MBOCP_LANES == 4 && defined(__FMA__)
#define mbocp_multiply_add(x, y, z) ((mbocp_lanes)__builtin_ia32_vfmaddpd256(x, y, z))
#elif defined(__AVX512F__)
#define mbocp_multiply_add(x, y, z) ((mbocp_lanes)__builtin_ia32_vfmaddpd512_mask(x, y, z, -1, 4))
#else
static inline __attribute__((unused)) mbocp_lanes mbocp_multiply_add(mbocp_lanes x, mbocp_lanes y, mbocp_lanes z) {
  int i;
  for (i = 0; i < MBOCP_LANES; ++i) z[i] = __builtin_fma(x[i], y[i], z[i]);
  return z;
}
#endif
static inline __attribute__((unused)) int mbocp_agree(mbocp_lanes x) {
  int i, agree = 1;
  for (i = 0; i < MBOCP_LANES; ++i) agree &= x[i] == x[0];
  return agree;
}
#define mbocp_where(mask, x) ((mbocp_lanes)((mask) & (mbocp_bits)(x)))
#define mbocp_select(mask, x, y) ((mbocp_lanes)(((mask) & (mbocp_bits)(x)) | (~(mask) & (mbocp_bits)(y))))
#define mbocp_truth(mask) mbocp_where(mask, mbocp_all(1.))
#define mbocp_is(x) ((x) != mbocp_all(0.))
#define mbocp_less(x, y) mbocp_truth((x) < (y))
#define mbocp_at_most(x, y) mbocp_truth((x) <= (y))
#define mbocp_equal(x, y) mbocp_truth((x) == (y))
#define mbocp_unequal(x, y) mbocp_truth((x) != (y))
#define mbocp_and(x, y) mbocp_truth(mbocp_is(x) & mbocp_is(y))
#define mbocp_or(x, y) mbocp_truth(mbocp_is(x) | mbocp_is(y))
#define mbocp_not(x) mbocp_truth((x) == mbocp_all(0.))
#define mbocp_if(x, y) mbocp_where(mbocp_is(x), y)
#define mbocp_fabs(x) mbocp_where(mbocp_all_bits(0x7fffffffffffffffLL), x)
#define mbocp_fmin(x, y) mbocp_select(((x) < (y)) | ((y) != (y)), x, y)
#define mbocp_fmax(x, y) mbocp_select(((x) > (y)) | ((y) != (y)), x, y)
#define mbocp_sign(x) mbocp_select((x) < mbocp_all(0.), mbocp_all(-1.), mbocp_select((x) > mbocp_all(0.), mbocp_all(1.), x))

/* A function of the library, lane by lane. */
#define MBOCP_EACH(f)                                                            \
  static __attribute__((noinline, unused)) mbocp_lanes mbocp_each_##f(mbocp_lanes x) { \
    int i;                                                                       \
    for (i = 0; i < MBOCP_LANES; ++i) x[i] = f(x[i]);                            \
    return x;                                                                    \
  }
#define MBOCP_EACH_OF_TWO(f)                                                                    \
  static __attribute__((noinline, unused)) mbocp_lanes mbocp_each_##f(mbocp_lanes x, mbocp_lanes y) { \
    int i;                                                                                      \
    for (i = 0; i < MBOCP_LANES; ++i) x[i] = f(x[i], y[i]);                                     \
    return x;                                                                                   \
  }

#ifndef __has_builtin
#define __has_builtin(x) 0
#endif
#if __has_builtin(__builtin_elementwise_sqrt) /* newer versions of Clang have no other one */
#define mbocp_sqrt(x) __builtin_elementwise_sqrt(x)
#elif MBOCP_LANES == 4 && defined(__AVX2__)
#define mbocp_sqrt(x) ((mbocp_lanes)__builtin_ia32_sqrtpd256(x))
#elif defined(__AVX512F__) && !defined(__clang__)
#define mbocp_sqrt(x) ((mbocp_lanes)__builtin_ia32_sqrtpd512_mask(x, x, -1, 4))
#else
MBOCP_EACH(sqrt)
#define mbocp_sqrt(x) mbocp_each_sqrt(x)
#endif

#ifdef __FAST_MATH__
MBOCP_EACH(sin)
MBOCP_EACH(cos)
#define mbocp_sin(x) mbocp_each_sin(x)
#define mbocp_cos(x) mbocp_each_cos(x)
#define mbocp_sin_and_cos(x, other) (*(other) = mbocp_cos(x), mbocp_sin(x))
#define mbocp_cos_and_sin(x, other) (*(other) = mbocp_sin(x), mbocp_cos(x))
#else
/* Sine or cosine of a quarter of the circle from those of the first. */
static inline __attribute__((unused)) mbocp_lanes mbocp_quarter(mbocp_bits place, mbocp_lanes sine, mbocp_lanes cosine) {
  mbocp_lanes y = mbocp_select((place & 1) != 0, cosine, sine);
  return (mbocp_lanes)((mbocp_bits)y ^ ((place & 2) << 62));
}

/* sin(x) and cos(x) within an ulp: x less a multiple n of pi / 2, in three parts of 33 bits and a rest, as a sum y
+ rest; then the polynomials of fdlibm (Sun Microsystems, 1993) for sine and cosine between -pi / 4 and pi / 4. n has at
most 20 bits up to the largest x, so that its products are exact; beyond, and where x is no number, the library is asked. */
static inline __attribute__((unused)) void mbocp_sines(mbocp_lanes x, mbocp_lanes* of_sine, mbocp_lanes* of_cosine) {
  const double largest = 1e5;
  const mbocp_lanes to_integer = mbocp_all(6755399441055744.); /* 1.5 2^52: the last bits of a sum with it count */
  mbocp_lanes shifted = mbocp_multiply_add(x, mbocp_all(6.36619772367581382433e-01), to_integer);
  mbocp_lanes n = shifted - to_integer, t = mbocp_multiply_add(n, mbocp_all(-1.57079632673412561417e+00), x);
  mbocp_lanes w = n * 6.07710050630396597660e-11, r = t - w, y, rest;
  mbocp_lanes z, v, sine, cosine, half, one_less;
  mbocp_bits place = (mbocp_bits)shifted, beyond = ~((x <= largest) & (x >= -largest));
  int i, any = 0;
  w = mbocp_multiply_add(n, mbocp_all(2.02226624879595063154e-21), -((t - r) - w));
  y = r - w;
  rest = (r - y) - w;
  z = y * y;
  v = z * y;
  sine = mbocp_multiply_add(z, mbocp_all(1.58969099521155010221e-10), mbocp_all(-2.50507602534068634195e-08));
  sine = mbocp_multiply_add(z, sine, mbocp_all(2.75573137070700676789e-06));
  sine = mbocp_multiply_add(z, sine, mbocp_all(-1.98412698298579493134e-04));
  sine = mbocp_multiply_add(z, sine, mbocp_all(8.33333333332248946124e-03));
  sine = mbocp_multiply_add(z, mbocp_multiply_add(-v, sine, 0.5 * rest), -rest);
  sine = y - mbocp_multiply_add(v, mbocp_all(1.66666666666666324348e-01), sine);
  cosine = mbocp_multiply_add(z, mbocp_all(-1.13596475577881948265e-11), mbocp_all(2.08757232129817482790e-09));
  cosine = mbocp_multiply_add(z, cosine, mbocp_all(-2.75573143513906633035e-07));
  cosine = mbocp_multiply_add(z, cosine, mbocp_all(2.48015872894767294178e-05));
  cosine = mbocp_multiply_add(z, cosine, mbocp_all(-1.38888888888741095749e-03));
  cosine = z * mbocp_multiply_add(z, cosine, mbocp_all(4.16666666666666019037e-02));
  half = 0.5 * z;
  one_less = 1. - half;
  cosine = one_less + (((1. - one_less) - half) + mbocp_multiply_add(z, cosine, -(y * rest)));
  *of_sine = mbocp_quarter(place, sine, cosine);
  *of_cosine = mbocp_quarter(place + 1, sine, cosine);
  for (i = 0; i < MBOCP_LANES; ++i) any |= beyond[i] != 0;
  if (__builtin_expect(any, 0))
    for (i = 0; i < MBOCP_LANES; ++i)
      if (beyond[i]) (*of_sine)[i] = sin(x[i]), (*of_cosine)[i] = cos(x[i]);
}
static __attribute__((noinline, unused)) mbocp_lanes mbocp_sin_and_cos(mbocp_lanes x, mbocp_lanes* other) {
  mbocp_lanes sine;
  mbocp_sines(x, &sine, other);
  return sine;
}
static __attribute__((noinline, unused)) mbocp_lanes mbocp_cos_and_sin(mbocp_lanes x, mbocp_lanes* other) {
  mbocp_lanes cosine;
  mbocp_sines(x, other, &cosine);
  return cosine;
}
static __attribute__((noinline, unused)) mbocp_lanes mbocp_sin(mbocp_lanes x) {
  mbocp_lanes sine, cosine;
  mbocp_sines(x, &sine, &cosine);
  return sine;
}
static __attribute__((noinline, unused)) mbocp_lanes mbocp_cos(mbocp_lanes x) {
  mbocp_lanes sine, cosine;
  mbocp_sines(x, &sine, &cosine);
  return cosine;
}
#endif
#endif
