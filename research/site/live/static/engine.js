"use strict";
// Calls the printed equations: disturbances that are the same for all vehicles, and a controller for each vehicle.
const ENGINE = (() => {
  const { sizes, at, measured: [FIRST_MEASURED, END_MEASURED] } = DATA;
  const zeros = (n) => new Float64Array(n);
  const AUTHORITY = zeros(2);

  function numbers(text, Kind) {
    const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    return new Kind(bytes.buffer);
  }

  // Standard normal numbers from a seed: Jenkins' small fast generator and the polar method of Marsaglia.
  function normals(seed) {
    let [a, b, c, d] = [0xf1ea5eed, seed, seed, seed];
    function uniform() {
      const e = (a - ((b << 27) | (b >>> 5))) | 0;
      a = b ^ ((c << 17) | (c >>> 15));
      b = (c + d) | 0;
      c = (d + e) | 0;
      d = (e + a) | 0;
      return (d >>> 0) / 4294967296;
    }
    for (let i = 0; i < 20; i++) uniform();
    return function normal() {
      for (;;) {
        const x = 2 * uniform() - 1, y = 2 * uniform() - 1, s = x * x + y * y;
        if (s > 0 && s < 1) return x * Math.sqrt((-2 * Math.log(s)) / s);
      }
    };
  }

  // The reference of a path at every control instant, and its positions after the last one.
  function referenceOf(path) {
    const rows = numbers(path.table, Float64Array), beyond = numbers(path.beyond, Float64Array);
    const last = rows.length / 8 - 1;
    const position = (k, axis) => (k <= last ? rows[8 * k + axis] : beyond[2 * (k - last - 1) + axis]);
    return {
      rows, last, position,
      row: (k) => rows.subarray(8 * Math.min(k, last), 8 * Math.min(k, last) + 8),
      ways: (k, periods) => Float64Array.from(
        periods.flatMap((n) => [0, 1].map((axis) => position(k + n, axis) - position(k, axis)))),
    };
  }

  // The disturbances of an episode: a sample for each control instant, scaled by the present settings.
  function seaOf(speed_range, path, seed, settings) {
    const own = speed_range.seeds[seed % speed_range.seeds.length], normal = normals(seed + 1);
    const gust = zeros(sizes.gust), noise = zeros(sizes.normals), weather = Float64Array.from(path.weather);
    const waves = zeros(own.waves.length), sea = zeros(sizes.sample - 8), sample = zeros(sizes.sample);
    function tune() {
      const { current, direction, gusts, waves: height, noise: noiseScale } = settings;
      weather[at.weather.V_x] = current * speed_range.speed * Math.cos(direction);
      weather[at.weather.V_y] = current * speed_range.speed * Math.sin(direction);
      weather[at.weather.sigma] = gusts * speed_range.speed;
      for (let i = 0; i < 6; i++) weather[at.weather.noise + i] = path.weather[at.weather.noise + i] * noiseScale;
      for (let i = 0; i < waves.length; i++) waves[i] = own.waves[i] * (i % sizes.waveRows ? height : 1);
    }
    return {
      sample,
      next(row) {
        tune();
        for (let i = 0; i < noise.length; i++) noise[i] = normal();
        EQUATIONS.sea(gust, noise, weather, waves, sea);
        sample.set(row);
        sample.set(sea, 8);
        return sample;
      },
    };
  }

  const CONTROLLERS = {
    openLoop: () => ({ act(seen, action) { EQUATIONS.openLoop(seen, action); } }),
    backstepping: () => ({ act(seen, action) { EQUATIONS.backstepping(seen, action); } }),
    ekf: ekfController,
    helm: () => agentController("helm"),
    you: handController,
  };

  // Commands of the keyboard, added to the planned forces: thrust and rudder from -1 to 1.
  const hand = [0, 0];
  function handController() {
    return {
      act(seen, action) {
        EQUATIONS.openLoop(seen, action);
        for (let i = 0; i < 2; i++) action[i] = Math.max(-1, Math.min(1, action[i] + 0.3 * hand[i]));
      },
    };
  }

  function ekfController(name, speed_range) {
    const { filters, law, memory, plan } = DATA.speed_ranges[speed_range].ekf;
    const planned = zeros(plan), terms = zeros(sizes.seen), force = zeros(2), estimate = zeros(Object.keys(at.estimate).length);
    const both = filters.map((known) => ({ known: Float64Array.from(known), memory: Float64Array.from(memory) }));
    const known = Float64Array.from(law);
    return {
      estimate,
      act(seen, action) {
        EQUATIONS.decoded(seen, terms);
        for (const each of both) EQUATIONS.filter(terms, each.known, each.memory, each.memory);
        EQUATIONS.combined(both[0].memory, both[1].memory, estimate);
        EQUATIONS.ekfLaw(terms, known, estimate, planned, force);
        EQUATIONS.forcesToAction(terms, force, action);
      },
    };
  }

  const networks = {};
  function networkOf(name) {
    if (!networks[name]) {
      const { shape, weights } = DATA.agents[name];
      const arrays = Object.entries(weights).map(([key, text]) => [key, numbers(text, Float32Array)]);
      networks[name] = EQUATIONS[`network_${shape}`](Object.fromEntries(arrays));
    }
    return networks[name];
  }

  function agentController(name) {
    const agent = DATA.agents[name], { shape, preview } = agent, network = networkOf(name);
    const see = EQUATIONS[`see_${shape}`], look = EQUATIONS[`preview_${shape}`];
    const features = zeros(agent.features), base = zeros(2), integrals = zeros(agent.integrals);
    const correction = zeros(2), hidden = zeros(agent.hidden), next = zeros(agent.hidden);
    const authority = Float64Array.from(agent.authority), columns = zeros(2 * preview.length);
    return {
      base, correction, authority, preview,
      act(seen, action, ways) {
        look(seen, ways, columns);
        see(seen, columns, correction, integrals, features, base);
        network(features, hidden, correction, next);
        hidden.set(next);
        EQUATIONS.command(base, authority, correction, action);
      },
    };
  }

  // A vehicle: its state, its observation and its controller.
  function vehicleOf(name, speed_range, parameters) {
    let controller = CONTROLLERS[name](name, speed_range);
    const state = zeros(sizes.state);
    const sides = [0, 1].map(() => ({ plant: zeros(sizes.plant), seen: zeros(sizes.seen) }));
    const outcome = zeros(sizes.outcome), action = zeros(2);
    return {
      name, action, outcome,
      get controller() { return controller; },
      get plant() { return sides[0].plant; },
      get before() { return sides[1].plant; },
      begin(values, sample) {
        state.set(values);
        EQUATIONS.start(state, sample, parameters, sides[0].plant, sides[0].seen);
        sides[1].plant.set(sides[0].plant);
      },
      // Starts again at the present position, at rest and with a new memory of the controller.
      restart(sample) {
        controller = CONTROLLERS[name](name, speed_range);
        this.begin([...sides[0].plant.subarray(0, 3), 0, 0, 0], sample);
      },
      step(sample, reference, k) {
        const [now, then] = sides;
        const ways = controller.preview ? reference.ways(k, controller.preview) : null;
        controller.act(now.seen, action, ways);
        EQUATIONS.step(now.plant, now.seen, action, AUTHORITY, sample, parameters, then.plant, then.seen, outcome);
        sides.reverse();
      },
    };
  }

  // The initial state of an episode, for the first row of its reference.
  function beginning(seed, row) {
    const [x, y, psi, surge] = seed.start;
    return [row[0] + x, row[1] + y, row[2] + psi, surge * row[3], 0, 0];
  }

  // Runs a controller through given samples, for tests. Returns commands, states and errors of every step.
  function replay(name, speed_range, family, samples, parameters, state) {
    const reference = referenceOf(DATA.speed_ranges[speed_range].paths[family]);
    const vehicle = vehicleOf(name, speed_range, Float64Array.from(parameters));
    const found = [];
    vehicle.begin(state, Float64Array.from(samples[0]));
    for (let k = 0; k + 1 < samples.length; k++) {
      vehicle.step(Float64Array.from(samples[k + 1]), reference, k);
      found.push([...vehicle.action, ...vehicle.plant.subarray(0, 8), vehicle.outcome[2]]);
    }
    return found;
  }

  return { referenceOf, seaOf, vehicleOf, beginning, replay, zeros, hand };
})();
