// One function for each PTX instruction, as NVIDIA's PTX ISA defines it; registers are integers of 64 or 32 bits.
#include <math.h>
#include <stdint.h>
#include <string.h>

typedef uint64_t u64;
typedef uint32_t u32;
typedef uint16_t u16;
typedef int16_t s16;
typedef int64_t s64;
typedef int32_t s32;

static inline double number(u64 bits) { double x; memcpy(&x, &bits, 8); return x; }
static inline u64 bits(double x) { u64 b; memcpy(&b, &x, 8); return b; }

#define ROUNDED(name, operator) \
  static inline u64 name##_rn_f64(u64 a, u64 b) { return bits(number(a) operator number(b)); }
ROUNDED(add, +)
ROUNDED(sub, -)
ROUNDED(mul, *)
ROUNDED(div, /)
static inline u64 sqrt_rn_f64(u64 a) { return bits(sqrt(number(a))); }
static inline u64 rcp_rn_f64(u64 a) { return bits(1.0 / number(a)); }
static inline u64 fma_rn_f64(u64 a, u64 b, u64 c) { return bits(fma(number(a), number(b), number(c))); }

static inline u64 neg_f64(u64 a) { return a ^ 0x8000000000000000ull; }
static inline u64 abs_f64(u64 a) { return a & 0x7fffffffffffffffull; }
static inline u64 copysign_f64(u64 sign, u64 a) { return abs_f64(a) | (sign & 0x8000000000000000ull); }
// A NaN gives way to a number, and -0.0 is less than +0.0.
static inline u64 max_f64(u64 a, u64 b) {
  if (isnan(number(a))) return b;
  if (number(a) == number(b)) return a & b;
  return number(a) < number(b) ? b : a;
}
static inline u64 min_f64(u64 a, u64 b) {
  if (isnan(number(a))) return b;
  if (number(a) == number(b)) return a | b;
  return number(b) < number(a) ? b : a;
}

static inline u64 cvt_rmi_f64_f64(u64 a) { return bits(floor(number(a))); }
static inline u64 cvt_rpi_f64_f64(u64 a) { return bits(ceil(number(a))); }
static inline u64 cvt_rzi_f64_f64(u64 a) { return bits(trunc(number(a))); }
static inline u64 cvt_rn_f64_s64(s64 a) { return bits((double)a); }
static inline u64 cvt_rn_f64_u64(u64 a) { return bits((double)a); }
static inline u64 cvt_rn_f64_s32(s32 a) { return bits((double)a); }
static inline u64 cvt_rn_f64_u32(u32 a) { return bits((double)a); }
static inline s64 cvt_rzi_s64_f64(u64 a) {  // NaN is 0, and what is too large is the largest
  double x = number(a);
  if (isnan(x)) return 0;
  return x >= 0x1p63 ? INT64_MAX : x < -0x1p63 ? INT64_MIN : (s64)x;
}
static inline u32 cvt_rn_f32_f64(u64 a) { float x = (float)number(a); u32 b; memcpy(&b, &x, 4); return b; }
static inline u64 cvt_u64_u32(u32 a) { return a; }
static inline u64 cvt_s64_s32(s32 a) { return (u64)(s64)a; }
static inline u32 cvt_u32_u64(u64 a) { return (u32)a; }

// Comparisons: ordered, and with u true if one is NaN.
#define ORDERED(name, operator) \
  static inline int setp_##name##_f64(u64 a, u64 b) { return number(a) operator number(b); }
#define UNORDERED(name, inverse) \
  static inline int setp_##name##_f64(u64 a, u64 b) { return !(number(a) inverse number(b)); }
ORDERED(eq, ==)
ORDERED(lt, <)
ORDERED(le, <=)
ORDERED(gt, >)
ORDERED(ge, >=)
UNORDERED(ltu, >=)
UNORDERED(leu, >)
UNORDERED(gtu, <=)
UNORDERED(geu, <)
static inline int setp_neu_f64(u64 a, u64 b) { return number(a) != number(b); }
static inline int setp_ne_f64(u64 a, u64 b) { return number(a) < number(b) || number(a) > number(b); }
static inline int setp_equ_f64(u64 a, u64 b) { return !setp_ne_f64(a, b); }
static inline int setp_nan_f64(u64 a, u64 b) { return isnan(number(a)) || isnan(number(b)); }
static inline int setp_num_f64(u64 a, u64 b) { return !setp_nan_f64(a, b); }
#define COMPARED(name, operator) \
  static inline int setp_##name##_s64(s64 a, s64 b) { return a operator b; } \
  static inline int setp_##name##_u64(u64 a, u64 b) { return a operator b; } \
  static inline int setp_##name##_b64(u64 a, u64 b) { return a operator b; } \
  static inline int setp_##name##_b16(u16 a, u16 b) { return a operator b; } \
  static inline int setp_##name##_u16(u16 a, u16 b) { return a operator b; } \
  static inline int setp_##name##_s16(s16 a, s16 b) { return a operator b; } \
  static inline int setp_##name##_s32(s32 a, s32 b) { return a operator b; } \
  static inline int setp_##name##_u32(u32 a, u32 b) { return a operator b; } \
  static inline int setp_##name##_b32(u32 a, u32 b) { return a operator b; }
COMPARED(eq, ==)
COMPARED(ne, !=)
COMPARED(lt, <)
COMPARED(le, <=)
COMPARED(gt, >)
COMPARED(ge, >=)

// Whole numbers wrap around.
#define WHOLE(name, kind, type, operator) \
  static inline type name##_##kind(type a, type b) { return a operator b; }
WHOLE(add, s64, u64, +)
WHOLE(add, u64, u64, +)
WHOLE(sub, s64, u64, -)
WHOLE(mul_lo, s64, u64, *)
WHOLE(mul_lo, s32, u32, *)
WHOLE(add, s32, u32, +)
WHOLE(div, s64, s64, /)
WHOLE(div, u32, u32, /)
WHOLE(div, u64, u64, /)
WHOLE(rem, s64, s64, %)
WHOLE(rem, u64, u64, %)
WHOLE(rem, u32, u32, %)
WHOLE(and, b64, u64, &)
WHOLE(or, b64, u64, |)
WHOLE(xor, b64, u64, ^)
WHOLE(and, b32, u32, &)
WHOLE(or, b32, u32, |)
WHOLE(xor, b32, u32, ^)
WHOLE(and, b16, u16, &)
WHOLE(or, b16, u16, |)
WHOLE(and, pred, int, &)
WHOLE(or, pred, int, |)
WHOLE(xor, pred, int, ^)
static inline int not_pred(int a) { return !a; }
static inline u64 not_b64(u64 a) { return ~a; }
static inline u64 neg_s64(u64 a) { return -a; }
static inline s64 min_s64(s64 a, s64 b) { return a < b ? a : b; }
static inline s64 max_s64(s64 a, s64 b) { return a > b ? a : b; }
static inline u64 mad_lo_s64(u64 a, u64 b, u64 c) { return a * b + c; }
static inline u32 mad_lo_s32(u32 a, u32 b, u32 c) { return a * b + c; }
static inline u64 mul_hi_u64(u64 a, u64 b) { return (u64)((unsigned __int128)a * b >> 64); }
static inline u32 neg_s32(u32 a) { return -a; }
static inline u64 mul_wide_s32(s32 a, s32 b) { return (u64)((s64)a * b); }
static inline u64 mul_wide_u32(u32 a, u32 b) { return (u64)a * b; }
static inline u64 shl_b64(u64 a, u32 b) { return b > 63 ? 0 : a << b; }
static inline u64 shr_u64(u64 a, u32 b) { return b > 63 ? 0 : a >> b; }
static inline s64 shr_s64(s64 a, u32 b) { return a >> (b > 63 ? 63 : b); }

static inline u64 ld_b64(u64 address) { u64 x; memcpy(&x, (void *)address, 8); return x; }
static inline void st_b64(u64 address, u64 x) { memcpy((void *)address, &x, 8); }
static inline u32 ld_b32(u64 address) { u32 x; memcpy(&x, (void *)address, 4); return x; }
static inline void st_b32(u64 address, u32 x) { memcpy((void *)address, &x, 4); }
static inline void st_b8(u64 address, u64 x) { *(unsigned char *)address = (unsigned char)x; }
static inline u16 ld_b8(u64 address) { return *(unsigned char *)address; }
