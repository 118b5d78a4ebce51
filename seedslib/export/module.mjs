@CODES

@TABLES
const isnan = Number.isNaN, isfinite = Number.isFinite, exp2 = (x) => 2 ** x;
const isinf = (x) => x === Infinity || x === -Infinity;
const { sqrt, cbrt, exp, expm1, log, log2, log10, log1p, sin, cos, tan, asin, acos, atan, atan2,
  sinh, cosh, tanh, asinh, acosh, atanh, hypot, floor, ceil, pow, abs: fabs } = Math;
function erf(x) { // a series near zero, a continued fraction farther out
  if (fabs(x) > 2) return x > 0 ? 1 - tail(x) : tail(-x) - 1;
  let term = x, sum = x;
  for (let k = 1; k < 100 && fabs(term) > 1e-17 * fabs(sum); k++) {
    term *= 2 * x * x / (2 * k + 1);
    sum += term;
  }
  return 2 / sqrt(Math.PI) * exp(-x * x) * sum;
}
const erfc = (x) => x > 2 ? tail(x) : 1 - erf(x);
function tail(x) {
  let f = x;
  for (let k = 200; k > 0; k--) f = x + k / 2 / f;
  return exp(-x * x) / sqrt(Math.PI) / f;
}

// Estimate and memory, all numbers in one array.
export class State {
  constructor(S = new Float64Array(@SIZE)) { this.S = S; }
  copy() { return new State(this.S.slice()); }
@GETTERS
}

function part(S, from, size) { // a plain array is made quickest
  const numbers = [];
  for (let i = from; i < from + size; i++) numbers.push(S[i]);
  return numbers;
}

export function init() {
  const state = new State();
@START  return state;
}

export function step(state, @GIVEN) {
  if (y.length !== @M) throw new RangeError(`y: wanted @M numbers, got ${y.length}`);
  return step_(state.S, @GIVEN);
}

function step_(S, @GIVEN) {
@LINES
  return OK;
}
@HALVES
// Room for what `run` finds, to be used again.
export function rows(count) {
  const [mean, cov, loglik] = [@N, @N * @N, 1].map((size) => new Float64Array(count * size));
  return { mean, cov, loglik };
}

// A record, its measurements one behind the other: all means, covariances and log-likelihoods.
export function run(state, @RECORD, into = rows(ys.length / @M)) {
  const { mean, cov, loglik } = into, S = state.S, y = new Float64Array(@M);
  for (let k = 0; k < ys.length / @M; k++) {
    for (let i = 0; i < @M; i++) y[i] = ys[k * @M + i];
    const code = step_(S, @EACH);
    if (code !== OK) throw new RangeError(`measurement ${k}: refused with code ${code}`);
    for (let i = 0; i < @N; i++) mean[k * @N + i] = S[@AT_MEAN + i];
    for (let i = 0; i < @N * @N; i++) cov[k * @N * @N + i] = S[@AT_COV + i];
    loglik[k] = S[@AT_LOGLIK];
  }
  return into;
}
