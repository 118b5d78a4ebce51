
// Forecast to a time, without a measurement.
export function predict(state, time@INPUTS) {
  const loglik = state.loglik, code = step_(state.S, time, new Array(@M).fill(NaN)@PASSED);
  state.S[@AT_LOGLIK] = loglik;
  return code;
}

// Correction by a measurement at the time of the state.
export function correct(state, y@INPUTS) {
  return state.S[@AT_STARTED] ? step(state, state.S[@AT_T], y@PASSED) : TIME;
}
