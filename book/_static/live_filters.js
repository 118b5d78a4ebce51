// Real filters on new paths, in the page: numbers by chance, systems, modules of
// seedslib.export.to_js, which are kept as text because a file can not be imported from a file.
"use strict";
const paths = (() => {
  // Seeded uniform (mulberry32) and normal (Box-Muller) numbers.
  function source(seed) {
    let s = seed >>> 0, kept = null;
    const uniform = () => {
      s = (s + 0x6d2b79f5) >>> 0;
      let t = Math.imul(s ^ (s >>> 15), 1 | s);
      t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
      return ((t ^ (t >>> 14)) >>> 0) / 4294967296;
    };
    const normal = () => {
      if (kept !== null) { const last = kept; kept = null; return last; }
      const r = Math.sqrt(-2 * Math.log(1 - uniform())), a = 2 * Math.PI * uniform();
      kept = r * Math.sin(a);
      return r * Math.cos(a);
    };
    return { uniform, normal };
  }

  // Systems: first(draw, o), then next(x, draw, o) up to the next measurement, sensor(x, draw, o).
  const PLANTS = {
    van_der_pol: {
      first: (draw) => { const d = Math.sqrt(0.15); return [2 + d * draw.normal(), d * draw.normal()]; },
      next(x, draw, o) {
        const h = 0.01, w = (Math.PI / 10) ** 2, root = Math.sqrt(h);
        let [a, b] = x;
        for (let i = 0; i < 50; i++) {
          const to = b + (-w * a + 2 * b * (1 - a * a)) * h + a * root * draw.normal();
          a += b * h;
          b = to;
        }
        return [a, b];
      },
      sensor: (x, draw, o) => [x[0] * x[0] + o.noise * draw.normal(), x[1] + o.noise * draw.normal()],
    },
    linear: { // the exact step, its two matrices from Python
      first: (draw) => [1 + draw.normal(), -0.5 + draw.normal()],
      next(x, draw, o) {
        const [a, b, c, d] = o.matrix, [p, q, r] = o.root, u = draw.normal(), v = draw.normal();
        return [a * x[0] + b * x[1] + p * u, c * x[0] + d * x[1] + q * u + r * v];
      },
      sensor: (x, draw) => [x[0] + 0.5 * draw.normal()],
    },
    flip: {
      first: (draw) => [1 + 0.5 * draw.normal()],
      next([x], draw) {
        for (let i = 0; i < 25; i++) {
          const rate = 0.3 + 0.2 * x * x, from = x;
          x += (x - x * x * x) * 0.01 + 0.05 * draw.normal();
          if (draw.uniform() < 1 - Math.exp(-0.01 * rate)) x += -2 * from + 0.3 * draw.normal();
        }
        return [x];
      },
      sensor: ([x], draw) => [x * (1 + 0.3 * draw.normal()) + 0.5 * draw.normal()],
    },
    switching: { // the state and, behind it, the mode
      first: (draw) => [draw.normal(), draw.uniform() < 0.5 ? 0 : 1],
      next([x, mode], draw, o) {
        const leave = o.rate * (0.35 - 0.3 * Math.exp(-x * x / 8));
        const back = o.rate * (0.1 + 0.5 * Math.exp(-x * x / 2));
        const to = draw.uniform() < (mode ? back : leave) ? 1 - mode : mode;
        return [(mode ? 0.6 * x : x + 1.8 * Math.sin(x)) + 0.5 * draw.normal(), to];
      },
      sensor: ([x, mode], draw) => [(mode ? 2 + x : x) + 2 * draw.normal()],
    },
  };

  // Paths of a system and their measurements, NaN where one is missing.
  function simulate(data, o, count, draw) {
    const plant = PLANTS[data.plant], K = data.times.length, found = { x: [], y: [] };
    for (let p = 0; p < count; p++) {
      const xs = [], ys = [];
      for (let k = 0, x; k < K; k++) {
        x = k ? plant.next(x, draw, o) : plant.first(draw, o);
        const y = plant.sensor(x, draw, o), lost = o.missing !== undefined && draw.uniform() < o.missing;
        xs.push(x);
        for (const part of y) ys.push(lost ? NaN : part);
      }
      found.x.push(xs);
      found.y.push(ys);
    }
    return found;
  }

  // A module of to_js from its text: a classic script can not import one from a file.
  function module_text({ lines, modules }, name) { // its lines are kept as runs: first, number
    const runs = modules[name], found = [];
    for (let i = 0; i < runs.length; i += 2) found.push(...lines.slice(runs[i], runs[i] + runs[i + 1]));
    return found.join("\n");
  }
  function module(data, name) {
    data.made ??= {};
    return data.made[name] ??= new Function(
      `${module_text(data, name).replace(/^export /gm, "")}\nreturn { init, run, rows };`)();
  }

  // A filter over all paths: root-mean-square errors with standard errors, and its first path.
  function score(data, name, paths) {
    const made = module(data, name), K = data.times.length, n = data.size, parts = data.parts;
    const room = made.rows(K), at = new Float64Array(K), sum = [0, 0];
    let first = null;
    paths.y.forEach((y, p) => {
      const state = made.init();
      if (data.timed.includes(name)) made.run(state, data.times, y, room);
      else made.run(state, y, room);
      first ??= { mean: [...room.mean], cov: [...room.cov] };
      let own = 0;
      for (let k = 0; k < K; k++) for (const i of parts) {
        const e = (room.mean[k * n + i] - paths.x[p][k][i]) ** 2;
        at[k] += e;
        own += e / K;
      }
      sum[0] += own;
      sum[1] += own * own;
    });
    const N = paths.y.length, mse = sum[0] / N, rms = Math.sqrt(mse);
    const error = Math.sqrt(Math.max(sum[1] / N - mse * mse, 0) / N) / (2 * rms);
    return { rms, error, at: Array.from(at, (e) => Math.sqrt(e / N)), first };
  }

  return { source, simulate, module, module_text, score, PLANTS };
})();
if (typeof exports === "object") exports.paths = paths;
