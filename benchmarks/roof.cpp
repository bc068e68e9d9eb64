// The roof that eiwa's fused flow is compared with: the same algorithm, hand-written for two fixed arms.
//
//   roof SAMPLES THREADS JOINTS PRECISION [KEY]
//
// JOINTS is 6 (the paper's arm, 0.26 m and 0.18 m) or 7 (a Panda), PRECISION f64 or f32, KEY the key of the
// SplitMix64 stream (1 when left out), so that eiwa's fill() with the same key visits the same samples.
// Each sample goes from its number to a voxel maximum: uniform point, joint angles, forward kinematics, geometric
// Jacobian at the tip in the base frame, w = sqrt(det(J J^T)), penalty 1 - exp(-K prod u(1-u)), normalisation,
// threshold, and for a right and a left base the cell's maximum and hit count.
//
// One JSON object goes to stdout: median, least and largest wall time of the repeats in ns per sample (grids cleared
// and merged included), "checksum" (the sum of all maxima), "hits" (samples in a cell, per sample) and
// "flops_per_sample", counted by running the same templates on a counting number: every addition, subtraction,
// multiplication, division, square root, rounding, minimum and comparison of columns is one, a fused multiply-add two;
// integer and bit operations (SplitMix64, signs, exponents, cell numbers) and the deposit are none.
//
// Vectors are GCC's, as wide as the processor's; rounding and compaction use AVX-512 where there is one.

#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <exception>
#include <stdexcept>
#include <string>
#include <thread>
#include <type_traits>
#include <utility>
#include <vector>

#if defined(__AVX512F__) && defined(__AVX512DQ__) && defined(__AVX512VL__)
#define ROOF_AVX512 1
#include <immintrin.h>
#else
#define ROOF_AVX512 0
#endif

#define ROOF_INLINE inline __attribute__((always_inline))

namespace
{

using Word = std::uint64_t;

constexpr int kBlock = 256;  // samples per block
constexpr Word kChunk = Word{1} << 15;  // samples that a thread takes at a time
constexpr std::size_t kRepeats = 15;
constexpr double kWarm = 0.1;  // s; until then a system may leave new threads on one processor
constexpr Word kGamma = 0x9E3779B97F4A7C15ull;
constexpr double kPi = 3.14159265358979323846;
constexpr double kThreshold = 0.3;

// ---------------------------------------------------------------------------------------------- vectors of columns

#if defined(__AVX512F__)
constexpr int kBytes = 64;
#elif defined(__AVX__)
constexpr int kBytes = 32;
#else
constexpr int kBytes = 16;
#endif

typedef double Doubles __attribute__((vector_size(kBytes)));
typedef float Singles __attribute__((vector_size(kBytes)));
typedef std::int64_t Longs __attribute__((vector_size(kBytes)));
typedef std::int32_t Ints __attribute__((vector_size(kBytes)));
typedef Word Words __attribute__((vector_size(kBytes)));
typedef std::uint32_t Halves __attribute__((vector_size(kBytes)));

template<typename T>
using Column = std::conditional_t<sizeof(T) == 8, Doubles, Singles>;
template<typename T>
constexpr int kLanes = kBytes / static_cast<int>(sizeof(T));

template<typename V, typename T>
ROOF_INLINE V splat(T value)
{
  return V{} + value;
}

#if ROOF_AVX512
ROOF_INLINE Doubles nearest(Doubles x) { return (Doubles)_mm512_roundscale_pd((__m512d)x, 8); }
ROOF_INLINE Singles nearest(Singles x) { return (Singles)_mm512_roundscale_ps((__m512)x, 8); }
ROOF_INLINE Doubles down(Doubles x) { return (Doubles)_mm512_roundscale_pd((__m512d)x, 9); }
ROOF_INLINE Singles down(Singles x) { return (Singles)_mm512_roundscale_ps((__m512)x, 9); }
ROOF_INLINE Doubles root(Doubles x) { return (Doubles)_mm512_sqrt_pd((__m512d)x); }
ROOF_INLINE Singles root(Singles x) { return (Singles)_mm512_sqrt_ps((__m512)x); }
#else
template<typename V>
ROOF_INLINE V nearest(V x)
{
  for (std::size_t i = 0; i < sizeof(V) / sizeof(x[0]); ++i)
    x[i] = std::nearbyint(x[i]);
  return x;
}
template<typename V>
ROOF_INLINE V down(V x)
{
  for (std::size_t i = 0; i < sizeof(V) / sizeof(x[0]); ++i)
    x[i] = std::floor(x[i]);
  return x;
}
template<typename V>
ROOF_INLINE V root(V x)
{
  for (std::size_t i = 0; i < sizeof(V) / sizeof(x[0]); ++i)
    x[i] = std::sqrt(x[i]);
  return x;
}
#endif

template<typename V>
ROOF_INLINE V larger(V a, V b)
{
  return a > b ? a : b;
}
template<typename V>
ROOF_INLINE V smaller(V a, V b)
{
  return a < b ? a : b;
}
ROOF_INLINE Doubles magnitude(Doubles x) { return (Doubles)((Words)x & ~(Word{1} << 63)); }
ROOF_INLINE Singles magnitude(Singles x) { return (Singles)((Halves)x & 0x7FFFFFFFu); }

/// x with its sign turned where n (integral) is odd.
ROOF_INLINE Doubles turned(Doubles x, Doubles n) { return (Doubles)((Longs)x ^ (__builtin_convertvector(n, Longs) << 63)); }
ROOF_INLINE Singles turned(Singles x, Singles n) { return (Singles)((Ints)x ^ (__builtin_convertvector(n, Ints) << 31)); }
/// 2^-n for integral n.
ROOF_INLINE Doubles halved(Doubles n) { return (Doubles)((1023 - __builtin_convertvector(n, Longs)) << 52); }
ROOF_INLINE Singles halved(Singles n) { return (Singles)((127 - __builtin_convertvector(n, Ints)) << 23); }

// -------------------------------------------------------------------------------------- a number that counts flops

/// Stands for a column; knows constants, and which results are the same, as the compiler does under -ffast-math.
struct Counted
{
  static inline long flops = 0;
  static inline long results = 0;
  bool known = true;
  double value = 0.0;
  long id = 0;

  Counted() = default;
  Counted(double constant) : value(constant) {}
  static Counted result(long cost)
  {
    Counted x;
    flops += cost;
    x.known = false;
    x.id = ++results;
    return x;
  }
  bool is(double constant) const { return known && value == constant; }
  bool operator==(const Counted & other) const { return known == other.known && value == other.value && id == other.id; }
};

Counted operator+(Counted a, Counted b)
{
  if (a.known && b.known)
    return a.value + b.value;
  return a.is(0) ? b : b.is(0) ? a : Counted::result(1);
}
Counted operator*(Counted a, Counted b)
{
  if (a.known && b.known)
    return a.value * b.value;
  if (a.is(0) || b.is(0))
    return 0.0;
  if (a.is(1) || b.is(1))
    return a.is(1) ? b : a;
  return Counted::result(a.is(-1) || b.is(-1) ? 0 : 1);
}
Counted operator-(Counted a, Counted b)
{
  if (a == b)
    return 0.0;
  if (a.known && b.known)
    return a.value - b.value;
  return b.is(0) ? a : Counted::result(a.is(0) ? 0 : 1);
}
Counted operator/(Counted, Counted) { return Counted::result(1); }
template<>
Counted splat<Counted, double>(double value)
{
  return value;
}
Counted nearest(Counted) { return Counted::result(1); }
Counted down(Counted) { return Counted::result(1); }
Counted root(Counted) { return Counted::result(1); }
Counted larger(Counted, Counted) { return Counted::result(1); }
Counted smaller(Counted, Counted) { return Counted::result(1); }
Counted magnitude(Counted x) { return x; }
Counted turned(Counted, Counted) { return Counted::result(0); }
Counted halved(Counted) { return Counted::result(0); }

// ------------------------------------------------------------------------------------------------- functions

/// Near-minimax polynomials in f^2 for f in [-1/2, 1/2] half turns: sin(pi f) / f and cos(pi f); and exp(-x).
template<typename T>
struct Coefficients;
template<>
struct Coefficients<double>
{
  static constexpr double sine[] = {
    3.141592653589793,     -5.167712780049969,    2.5501640398773398,    -0.5992645293203429,   0.08214588659675222,
    -0.007370430719633726, 0.00046630087410947513, -2.1906201637837727e-05, 7.725742817962152e-07};
  static constexpr double cosine[] = {
    1.0,                  -4.934802200544679,   4.058712126416767,       -1.335262768854193,    0.23533063033352303,
    -0.02580689078071908, 0.0019295673377140378, -0.00010459711584886329, 4.183289371372078e-06};
  static constexpr double exponential[] = {1.0,         1.0,          1.0 / 2,       1.0 / 6,       1.0 / 24,
                                           1.0 / 120,   1.0 / 720,    1.0 / 5040,    1.0 / 40320,   1.0 / 362880,
                                           1.0 / 3628800, 1.0 / 39916800};
};
template<>
struct Coefficients<float>
{
  static constexpr float sine[] = {3.141592653589793f, -5.167712562122931f, 2.550136131342772f, -0.5987048572826333f,
                                   0.0785397116381781f};
  static constexpr float cosine[] = {1.0f, -4.934802200544679f, 4.058712069104909f, -1.3352554298153796f,
                                     0.23518351172115168f, -0.024859871422077632f};
  static constexpr float exponential[] = {1.0f, 1.0f, 1.0f / 2, 1.0f / 6, 1.0f / 24, 1.0f / 120, 1.0f / 720};
};

template<typename V, typename T, std::size_t N>
ROOF_INLINE V polynomial(V x, const T (&coefficients)[N])
{
  V total = splat<V>(coefficients[N - 1]);
#pragma GCC unroll 16
  for (int k = static_cast<int>(N) - 2; k >= 0; --k)
    total = total * x + coefficients[k];
  return total;
}

/// Sine and cosine of x half turns.
template<typename T, typename V>
ROOF_INLINE void sincos_half_turns(V x, V & s, V & c)
{
  const V n = nearest(x);
  const V f = x - n;
  const V t = f * f;
  s = turned(f * polynomial(t, Coefficients<T>::sine), n);
  c = turned(polynomial(t, Coefficients<T>::cosine), n);
}

/// 1 - exp(-x) for x >= 0.
template<typename T, typename V>
ROOF_INLINE V one_minus_exp(V x)
{
  x = smaller(x, splat<V>(T(40)));
  const V n = nearest(x * T(1.4426950408889634));
  const V rest = n * T(0.6931471805599453) - x;
  return T(1) - polynomial(rest, Coefficients<T>::exponential) * halved(n);
}

template<typename V>
struct Vector
{
  V x, y, z;
};

template<typename V>
ROOF_INLINE Vector<V> operator+(const Vector<V> & a, const Vector<V> & b)
{
  return {a.x + b.x, a.y + b.y, a.z + b.z};
}
template<typename V>
ROOF_INLINE Vector<V> operator-(const Vector<V> & a, const Vector<V> & b)
{
  return {a.x - b.x, a.y - b.y, a.z - b.z};
}
template<typename S, typename V>
ROOF_INLINE Vector<V> operator*(const S & s, const Vector<V> & a)
{
  return {s * a.x, s * a.y, s * a.z};
}
template<typename V>
ROOF_INLINE Vector<V> cross(const Vector<V> & a, const Vector<V> & b)
{
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

// ------------------------------------------------------------------------------------------------- arms

/// One modified (Craig) DH row: T = Rx(alpha) Tx(a) Rz(theta) Tz(d); alpha in right angles, a and d in m, limits in
/// half turns.
struct Row
{
  int alpha;
  double a, d, lower, upper;
};

template<int N>
struct Table;
template<>
struct Table<6>
{
  static constexpr double kLimit = 120.0 / 180.0;
  static constexpr Row rows[] = {
    {0, 0.0, 0.0, -kLimit, kLimit},   {1, 0.0, 0.0, -kLimit, kLimit},  {-1, 0.26, 0.0, -kLimit, kLimit},
    {0, 0.18, 0.0, -kLimit, kLimit},  {-1, 0.0, 0.0, -kLimit, kLimit}, {1, 0.0, 0.0, -kLimit, kLimit}};
  static constexpr double K = 12270.0;
  static constexpr double normaliser = 0.01034799448;
};
template<>
struct Table<7>
{
  static constexpr Row rows[] = {
    {0, 0.0, 0.333, -2.8973 / kPi, 2.8973 / kPi},    {-1, 0.0, 0.0, -1.7628 / kPi, 1.7628 / kPi},
    {1, 0.0, 0.316, -2.8973 / kPi, 2.8973 / kPi},    {1, 0.0825, 0.0, -3.0718 / kPi, -0.0698 / kPi},
    {-1, -0.0825, 0.384, -2.8973 / kPi, 2.8973 / kPi}, {1, 0.0, 0.0, -0.0175 / kPi, 3.7525 / kPi},
    {1, 0.088, 0.107, -2.8973 / kPi, 2.8973 / kPi}};
  static constexpr double K = 49080.0;
  static constexpr double normaliser = 0.109593544;
};

/// Forward kinematics: frame axes x, y, z and origin after each joint, all in the base frame.
template<typename T, int N, typename V>
struct Chain
{
  Vector<V> x{splat<V>(T(1)), splat<V>(T(0)), splat<V>(T(0))};
  Vector<V> y{splat<V>(T(0)), splat<V>(T(1)), splat<V>(T(0))};
  Vector<V> z{splat<V>(T(0)), splat<V>(T(0)), splat<V>(T(1))};
  Vector<V> tip{splat<V>(T(0)), splat<V>(T(0)), splat<V>(T(0))};
  Vector<V> axes[N], origins[N];

  /// Joint J at the point u of its range.
  template<int J>
  ROOF_INLINE void step(V u)
  {
    constexpr Row row = Table<N>::rows[J];
    if constexpr (row.a != 0.0)
      tip = tip + T(row.a) * x;
    if constexpr (row.alpha != 0)
    {
      const Vector<V> before = y;
      y = T(row.alpha) * z;
      z = T(-row.alpha) * before;
    }
    if constexpr (row.d != 0.0)
      tip = tip + T(row.d) * z;
    axes[J] = z;
    origins[J] = tip;
    if constexpr (J + 1 < N)  // the tip lies on the last axis
    {
      V s, c;
      sincos_half_turns<T>(u * T(row.upper - row.lower) + T(row.lower), s, c);
      const Vector<V> turned_x = c * x + s * y;
      y = c * y - s * x;
      x = turned_x;
    }
  }
};

/// |det A| by Laplace expansion along the rows, every minor computed once.
template<typename T, typename V>
ROOF_INLINE V volume(V (&A)[6][6])
{
  V minors[64];
  minors[0] = splat<V>(T(1));
#pragma GCC unroll 64
  for (unsigned chosen = 1; chosen < 64; ++chosen)
  {
    const int row = __builtin_popcount(chosen) - 1;
    V total = splat<V>(T(0));
    int position = 0;
#pragma GCC unroll 6
    for (int j = 0; j < 6; ++j)
    {
      if ((chosen >> j & 1) == 0)
        continue;
      const V term = A[row][j] * minors[chosen & ~(1u << j)];
      total = (position + row) % 2 == 0 ? total + term : total - term;
      ++position;
    }
    minors[chosen] = total;
  }
  return magnitude(minors[63]);
}

/// sqrt(det(A A^T)) in double: LDLt of the Gram matrix.
template<typename T, typename V>
ROOF_INLINE std::enable_if_t<sizeof(T) == 8, V> volume(V (&A)[6][7])
{
  V gram[6][6];
#pragma GCC unroll 6
  for (int i = 0; i < 6; ++i)
#pragma GCC unroll 6
    for (int j = 0; j <= i; ++j)
    {
      gram[i][j] = A[i][0] * A[j][0];
#pragma GCC unroll 7
      for (int k = 1; k < 7; ++k)
        gram[i][j] = gram[i][j] + A[i][k] * A[j][k];
    }
  V determinant = gram[0][0];
#pragma GCC unroll 6
  for (int k = 0; k < 5; ++k)
  {
    const V inverse = T(1) / larger(gram[k][k], splat<V>(T(1e-30)));
#pragma GCC unroll 6
    for (int i = k + 1; i < 6; ++i)
    {
      const V share = gram[i][k] * inverse;
#pragma GCC unroll 6
      for (int j = k + 1; j <= i; ++j)
        gram[i][j] = gram[i][j] - share * gram[j][k];
    }
    determinant = determinant * gram[k + 1][k + 1];
  }
  return root(larger(determinant, splat<V>(T(0))));
}

/// sqrt(det(A A^T)) in single: modified Gram-Schmidt on the rows, since a Gram matrix squares the condition number.
template<typename T, typename V>
ROOF_INLINE std::enable_if_t<sizeof(T) == 4, V> volume(V (&A)[6][7])
{
  V products[2] = {splat<V>(T(1)), splat<V>(T(1))};
#pragma GCC unroll 6
  for (int k = 0; k < 6; ++k)
  {
    V square = A[k][0] * A[k][0];
#pragma GCC unroll 7
    for (int c = 1; c < 7; ++c)
      square = square + A[k][c] * A[k][c];
    products[k / 3] = products[k / 3] * square;
    if (k == 5)
      break;
    const V inverse = T(1) / larger(square, splat<V>(T(1e-30)));
#pragma GCC unroll 6
    for (int i = k + 1; i < 6; ++i)
    {
      V share = A[k][0] * A[i][0];
#pragma GCC unroll 7
      for (int c = 1; c < 7; ++c)
        share = share + A[k][c] * A[i][c];
      share = share * inverse;
#pragma GCC unroll 7
      for (int c = 0; c < 7; ++c)
        A[i][c] = A[i][c] - share * A[k][c];
    }
  }
  return root(products[0]) * root(products[1]);
}

/// Tip [m] and normalised, penalised manipulability.
template<typename V>
struct Posture
{
  Vector<V> tip;
  V dexterity;
};

template<typename T, int N, typename V, std::size_t... J>
ROOF_INLINE Posture<V> evaluate(const V (&u)[N], std::index_sequence<J...>)
{
  Chain<T, N, V> chain;
  (chain.template step<J>(u[J]), ...);
  V margin = splat<V>(T(Table<N>::K));
  ((margin = margin * (u[J] - u[J] * u[J])), ...);
  V jacobian[6][N];
  const auto fill_column = [&](std::size_t j) __attribute__((always_inline))
  {
    const Vector<V> linear = cross(chain.axes[j], chain.tip - chain.origins[j]);
    jacobian[0][j] = linear.x, jacobian[1][j] = linear.y, jacobian[2][j] = linear.z;
    jacobian[3][j] = chain.axes[j].x, jacobian[4][j] = chain.axes[j].y, jacobian[5][j] = chain.axes[j].z;
  };
  (fill_column(J), ...);
  const V w = volume<T>(jacobian);
  return {chain.tip, w * T(1.0 / Table<N>::normaliser) * one_minus_exp<T>(margin)};
}

// ------------------------------------------------------------------------------------------------- sampling

ROOF_INLINE Words mixed(Words z)
{
  z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9ull;
  z = (z ^ (z >> 27)) * 0x94D049BB133111EBull;
  return z ^ (z >> 31);
}

/// Coordinate j of the samples from `first` on, SplitMix64 in sample-major order.
template<typename T, int N>
ROOF_INLINE Column<T> uniform(Word key, Word first, int j)
{
  constexpr int kWords = kBytes / 8;
  Words state;
  for (int i = 0; i < kWords; ++i)
    state[i] = kGamma * N * static_cast<Word>(i);
  state += key + kGamma * (first * N + static_cast<Word>(j) + 1);
  if constexpr (sizeof(T) == 8)
    return (Doubles)((mixed(state) >> 12) | 0x3FF0000000000000ull) - (1.0 - 0x1p-53);
  else
  {
    const Words low = mixed(state), high = mixed(state + kGamma * N * static_cast<Word>(kWords));
    // Which lane holds which sample is immaterial to maxima and counts, as long as it is the same for every joint.
    const Halves tops = (Halves)((low >> 32) | (high & 0xFFFFFFFF00000000ull));
    return (Singles)((tops >> 9) | 0x3F800000u) - (1.0f - 0x1p-24f);
  }
}

// ------------------------------------------------------------------------------------------------- voxels

constexpr int kShape[3] = {76, 26, 38};  // x [-.38, .38], y [.26, .52], z [-.08, .30] at 10 mm
constexpr int kCells = kShape[0] * kShape[1] * kShape[2];

/// Base frame to cell coordinates, for a base turned by -90 degrees about z.
template<typename T>
struct Affine
{
  T m[12];

  explicit Affine(double base_x)
  : m{T(0), T(100), T(0), T((base_x + 0.38) * 100), T(-100), T(0), T(0), T((0.802 - 0.26) * 100),
      T(0), T(0), T(100), T((0.10 + 0.08) * 100)}
  {
  }
};

template<typename T>
struct Cell
{
  T best;
  std::conditional_t<sizeof(T) == 8, std::uint64_t, std::uint32_t> hits;
};

/// Samples of a block that fell into one target.
template<typename T>
struct alignas(64) Found
{
  std::int32_t cells[kBlock + 64];
  T values[kBlock + 64];
  int count;
};

#if ROOF_AVX512
ROOF_INLINE unsigned inside(Doubles x, double end)
{
  const __mmask8 low = _mm512_cmp_pd_mask((__m512d)x, _mm512_setzero_pd(), _CMP_GE_OQ);
  return _mm512_mask_cmp_pd_mask(low, (__m512d)x, _mm512_set1_pd(end), _CMP_LT_OQ);
}
ROOF_INLINE unsigned inside(Singles x, float end)
{
  const __mmask16 low = _mm512_cmp_ps_mask((__m512)x, _mm512_setzero_ps(), _CMP_GE_OQ);
  return _mm512_mask_cmp_ps_mask(low, (__m512)x, _mm512_set1_ps(end), _CMP_LT_OQ);
}
ROOF_INLINE void append(Found<double> & found, Doubles cell, Doubles value, unsigned mask)
{
  const __m256i cells = _mm256_maskz_compress_epi32(mask, _mm512_cvttpd_epi32((__m512d)cell));
  _mm256_storeu_si256(reinterpret_cast<__m256i *>(found.cells + found.count), cells);
  _mm512_storeu_pd(found.values + found.count, _mm512_maskz_compress_pd(mask, (__m512d)value));
  found.count += __builtin_popcount(mask);
}
ROOF_INLINE void append(Found<float> & found, Singles cell, Singles value, unsigned mask)
{
  const __m512i cells = _mm512_maskz_compress_epi32(mask, _mm512_cvttps_epi32((__m512)cell));
  _mm512_storeu_si512(found.cells + found.count, cells);
  _mm512_storeu_ps(found.values + found.count, _mm512_maskz_compress_ps(mask, (__m512)value));
  found.count += __builtin_popcount(mask);
}
#else
template<typename V, typename T, std::enable_if_t<!std::is_same_v<V, Counted>, int> = 0>
ROOF_INLINE unsigned inside(V x, T end)
{
  unsigned mask = 0;
  for (int i = 0; i < kLanes<T>; ++i)
    mask |= static_cast<unsigned>((x[i] >= 0) & (x[i] < end)) << i;
  return mask;
}
template<typename V, typename T>
ROOF_INLINE void append(Found<T> & found, V cell, V value, unsigned mask)
{
  for (int i = 0; i < kLanes<T>; ++i)
  {
    found.cells[found.count] = static_cast<std::int32_t>(cell[i]);
    found.values[found.count] = value[i];
    found.count += mask >> i & 1;
  }
}
#endif

unsigned inside(Counted, Counted)
{
  Counted::flops += 2;
  return 0;
}
struct Nothing
{
};
void append(Nothing &, Counted, Counted, unsigned) {}

template<typename T, typename V, typename A, typename F>
ROOF_INLINE void locate(const Vector<V> & p, V value, const A & m, F & found)
{
  const V i = m[0] * p.x + m[1] * p.y + m[2] * p.z + m[3];
  const V j = m[4] * p.x + m[5] * p.y + m[6] * p.z + m[7];
  const V k = m[8] * p.x + m[9] * p.y + m[10] * p.z + m[11];
  const unsigned mask = inside(i, T(kShape[0])) & inside(j, T(kShape[1])) & inside(k, T(kShape[2]));
  append(found, (down(i) * T(kShape[1]) + down(j)) * T(kShape[2]) + down(k), value, mask);
}

template<typename T>
ROOF_INLINE void deposit(const Found<T> & found, Cell<T> * grid)
{
  for (int s = 0; s < found.count; ++s)
  {
    const T value = std::min(found.values[s], T(1));
    Cell<T> & cell = grid[found.cells[s]];
    cell.hits += 1;
    cell.best = std::max(cell.best, value >= T(kThreshold) ? value : T(0));
  }
}

// ------------------------------------------------------------------------------------------------- the flow

template<typename T, int N, std::size_t... J>
ROOF_INLINE void run_block(
  Word key, Word first, const Affine<T> (&affines)[2], Cell<T> * grid, std::index_sequence<J...> joints)
{
  using V = Column<T>;
  alignas(64) T x[kBlock], y[kBlock], z[kBlock], dexterity[kBlock];
  const auto at = [](T * row, int s) __attribute__((always_inline)) -> V & { return *reinterpret_cast<V *>(row + s); };
  for (int s = 0; s < kBlock; s += kLanes<T>)
  {
    const V u[N] = {uniform<T, N>(key, first + static_cast<Word>(s), J)...};
    const Posture<V> posture = evaluate<T, N>(u, joints);
    at(x, s) = posture.tip.x, at(y, s) = posture.tip.y, at(z, s) = posture.tip.z;
    at(dexterity, s) = posture.dexterity;
  }
  Found<T> found[2];
  found[0].count = found[1].count = 0;
  for (int s = 0; s < kBlock; s += kLanes<T>)
  {
    const Vector<V> tip{at(x, s), at(y, s), at(z, s)};
    locate<T>(tip, at(dexterity, s), affines[0].m, found[0]);
    locate<T>(tip, at(dexterity, s), affines[1].m, found[1]);
  }
  deposit(found[0], grid);
  deposit(found[1], grid + kCells);
}

/// The threads' grids, which stay from call to call and cost no fresh pages.
template<typename T>
using Grids = std::vector<std::vector<Cell<T>>>;

/// What the threads of one call share: the next chunk, and how many have run out of chunks.
struct Shared
{
  std::atomic<Word> chunk{0}, done{0};
};

template<typename T, int N>
void run_thread(Word key, Word samples, Word thread, Shared & shared, Grids<T> & grids)
{
  const Affine<T> affines[2] = {Affine<T>(0.1), Affine<T>(-0.1)};
  const Word threads = grids.size();
  grids[thread].assign(2 * kCells, Cell<T>{0, 0});
  for (Word chunk; (chunk = kChunk * shared.chunk++) < samples;)
    for (Word first = chunk; first < std::min(chunk + kChunk, samples); first += kBlock)
      run_block<T, N>(key, first, affines, grids[thread].data(), std::make_index_sequence<N>());
  ++shared.done;
  while (shared.done < threads)
    std::this_thread::yield();
  Cell<T> * const merged = grids[0].data();
  for (Word t = 1; t < threads; ++t)
    for (Word c = 2 * kCells * thread / threads; c < 2 * kCells * (thread + 1) / threads; ++c)
    {
      merged[c].best = std::max(merged[c].best, grids[t][c].best);
      merged[c].hits += grids[t][c].hits;
    }
}

/// Leaves the merged cells of both arms in grids[0].
template<typename T, int N>
void run_threads(Word key, Word samples, Grids<T> & grids)
{
  Shared shared;
  const auto work = [&](Word t) { run_thread<T, N>(key, samples, t, shared, grids); };
  std::vector<std::thread> team;
  for (Word t = 1; t < grids.size(); ++t)
    team.emplace_back(work, t);
  work(0);
  for (std::thread & member : team)
    member.join();
}

/// Flops of one sample in the terms of the head of this file.
template<typename T, int N>
long count_flops()
{
  Counted::flops = N;  // the subtraction that ends each coordinate
  Counted u[N], affine[12];
  for (Counted & x : u)
    x = Counted::result(0);
  for (Counted & x : affine)
    x = Counted::result(0);
  const Posture<Counted> posture = evaluate<T, N, Counted>(u, std::make_index_sequence<N>());
  Nothing nothing;
  for (int target = 0; target < 2; ++target)
    locate<T>(posture.tip, posture.dexterity, affine, nothing);
  return Counted::flops;
}

struct Arguments
{
  Word samples, threads;
  int joints;
  std::string precision;
  Word key;
};

template<typename T, int N>
void time_and_print(const Arguments & arguments)
{
  Grids<T> grids(arguments.threads);
  const auto begin = std::chrono::steady_clock::now();
  do
    run_threads<T, N>(arguments.key, arguments.samples, grids);
  while (std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count() < kWarm);
  std::array<double, kRepeats> ns{};
  for (double & value : ns)
  {
    const auto start = std::chrono::steady_clock::now();
    run_threads<T, N>(arguments.key, arguments.samples, grids);
    const std::chrono::duration<double, std::nano> elapsed = std::chrono::steady_clock::now() - start;
    value = elapsed.count() / static_cast<double>(arguments.samples);
  }
  std::sort(ns.begin(), ns.end());
  double checksum = 0.0, hits = 0.0;
  for (const Cell<T> & cell : grids[0])
  {
    checksum += static_cast<double>(cell.best);
    hits += static_cast<double>(cell.hits);
  }
  std::printf(
    "{\"samples\": %llu, \"threads\": %llu, \"joints\": %d, \"precision\": \"%s\", \"key\": %llu, "
    "\"ns_per_sample\": %.4f, \"ns_per_sample_min\": %.4f, \"ns_per_sample_max\": %.4f, "
    "\"checksum\": %.15g, \"hits\": %.9g, \"flops_per_sample\": %ld, \"vector_bytes\": %d, \"normaliser\": %.12g}\n",
    static_cast<unsigned long long>(arguments.samples), static_cast<unsigned long long>(arguments.threads), N,
    arguments.precision.c_str(), static_cast<unsigned long long>(arguments.key), ns[kRepeats / 2], ns.front(), ns.back(),
    checksum, hits / static_cast<double>(arguments.samples), count_flops<T, N>(), kBytes, Table<N>::normaliser);
}

Word whole(const std::string & text)
{
  if (text.empty() || text.find_first_not_of("0123456789") != std::string::npos)
    throw std::invalid_argument("not a whole number: '" + text + "'");
  return std::stoull(text);
}

Arguments parse(const std::vector<std::string> & words)
{
  if (words.size() != 4 && words.size() != 5)
    throw std::invalid_argument("usage: roof SAMPLES THREADS JOINTS PRECISION [KEY]");
  const Arguments arguments{
    whole(words[0]), whole(words[1]), static_cast<int>(whole(words[2])), words[3],
    words.size() == 5 ? whole(words[4]) : 1};
  if (arguments.samples == 0 || arguments.samples % kBlock != 0 || arguments.threads == 0)
    throw std::invalid_argument("SAMPLES must be a positive multiple of 256, THREADS positive");
  if (arguments.joints != 6 && arguments.joints != 7)
    throw std::invalid_argument("JOINTS must be 6 or 7");
  if (arguments.precision != "f64" && arguments.precision != "f32")
    throw std::invalid_argument("PRECISION must be f64 or f32");
  return arguments;
}

void run(const Arguments & arguments)
{
  const bool twice = arguments.precision == "f64";
  if (arguments.joints == 6)
    twice ? time_and_print<double, 6>(arguments) : time_and_print<float, 6>(arguments);
  else
    twice ? time_and_print<double, 7>(arguments) : time_and_print<float, 7>(arguments);
}

}  // namespace

int main(int argc, char ** argv)
{
  try
  {
    run(parse(std::vector<std::string>(argv + 1, argv + argc)));
  }
  catch (const std::exception & error)
  {
    std::fprintf(stderr, "roof: %s\n", error.what());
    return 1;
  }
  return 0;
}
