"use strict";
// The page: choices, time, dragging, and panels.
const PAGE = (() => {
  const $ = (id) => document.getElementById(id);
  const KINDS = {
    backstepping: { title: "Expert", text: "A backstepping law of 2005. It has no model of the disturbances.", colour: DATA.colours.backstepping },
    ekf: { title: "Expert + Kalman filter", text: "Estimates current, waves and lag, and compensates them.", colour: DATA.colours.ekf },
    helm: { title: "Trained agent", text: "A network gives the whole command. It also sees the next seconds of the path.", colour: DATA.colours.helm },
    openLoop: { title: "No feedback", text: "The planned forces alone.", colour: DATA.colours["open-loop"] },
    you: { title: "You", text: "Arrow keys change the planned thrust and rudder.", colour: "#8a5cd6" },
  };
  const CASES = {
    calm: "Calm", noise: "Noisy sensors", current: "Current", "gauss-markov": "Gusts", waves: "Waves",
    mismatch: "Wrong model", actuator: "Slow actuators", storm: "Storm",
  };
  const SPEED_RANGES = { cruise: "Cruise, 1 m/s", slow: "Slow, 0.2 m/s" };
  const SLIDERS = [
    ["current", "Current", 0, 0.6, 0.01, (v, r) => `${(v * r.speed).toFixed(2)} m/s`],
    ["direction", "Direction of the current", 0, 6.28, 0.02, (v) => `${Math.round((v * 180) / Math.PI)}\u00b0`],
    ["gusts", "Gusts", 0, 0.3, 0.01, (v, r) => `${(v * r.speed).toFixed(2)} m/s`],
    ["waves", "Waves", 0, 2, 0.05, (v) => `${Math.round(100 * v)} %`],
    ["noise", "Sensor noise", 0, 6, 0.05, (v) => `${Math.round(100 * v)} %`],
  ];
  const TOGGLES = [["mismatch", "Model error (mass, drag)"], ["actuator", "Slow and weak actuators"]];
  const SPEEDS = [1, 2, 4, 8];
  const WINDOW = 10, TRAIL = 400, REST = 2.5, LENGTH = { cruise: 1.5, slow: 0.6 };

  const chosen = { speed_range: "cruise", family: "figure_eight", seed: 0, preset: "storm", speed: 2, mismatch: false, actuator: false, on: new Set(["backstepping", "ekf", "helm"]) };
  const settings = { current: 0, direction: 0, gusts: 0, waves: 0, noise: 0 };
  const stats = { frames: 0, milliseconds: 0, slowest: 0 };
  let run = null, playing = true, held = null, since = null, touched = false;
  const view = { x: 0, y: 0, scale: 20, w: 1, h: 1 };

  const speed_range = () => DATA.speed_ranges[chosen.speed_range];
  const own = () => speed_range().seeds[chosen.seed % speed_range().seeds.length];
  const vehicleKind = () => (chosen.mismatch ? (chosen.actuator ? "both" : "mismatch") : chosen.actuator ? "actuator" : "plain");

  function begin() {
    const r = speed_range(), path = r.paths[chosen.family], reference = ENGINE.referenceOf(path);
    const sea = ENGINE.seaOf(r, path, chosen.seed, settings), first = Float64Array.from(sea.next(reference.row(0)));
    const parameters = Float64Array.from(own().vehicles[vehicleKind()]);
    const vehicles = Object.keys(KINDS).map((name) => {
      const vehicle = ENGINE.vehicleOf(name, chosen.speed_range, parameters);
      vehicle.begin(ENGINE.beginning(own(), reference.row(0)), first);
      return { name, vehicle, trail: [], points: [[0, distance(vehicle, reference.row(0))]], squares: [] };
    });
    run = { reference, sea, vehicles, k: 0, due: 0, marks: [], over: 0 };
    held = null;
  }

  function distance(vehicle, row) {
    return Math.hypot(vehicle.plant[0] - row[0], vehicle.plant[1] - row[1]);
  }

  function step() {
    const row = run.reference.row(run.k + 1), sample = run.sea.next(row), t = (run.k + 1) * speed_range().dt;
    for (const each of run.vehicles) {
      each.vehicle.step(sample, run.reference, run.k);
      if (held) pin(each.vehicle);
      const error = distance(each.vehicle, row);
      each.points.push([t, error]);
      each.squares.push(error * error);
      if (each.squares.length > WINDOW / speed_range().dt) each.squares.shift();
      each.trail.push(held ? null : [each.vehicle.plant[0], each.vehicle.plant[1]]);
      if (each.trail.length > TRAIL) each.trail.shift();
    }
    if (held) run.marks[run.marks.length - 1][1] = t;
    run.k += 1;
  }

  // While the vehicles are dragged, they are at the pointer and at rest.
  function pin(vehicle) {
    for (const plant of [vehicle.plant, vehicle.before]) {
      plant[DATA.at.plant.x] = held.x;
      plant[DATA.at.plant.y] = held.y;
      for (const name of ["u", "v", "r"]) plant[DATA.at.plant[name]] = 0;
    }
  }

  function advance(seconds) {
    const dt = speed_range().dt;
    if (run.k >= run.reference.last) {
      run.over += seconds;
      if (run.over > REST && !held) { chosen.seed += 1; begin(); }
      return;
    }
    run.due += seconds * chosen.speed;
    for (let n = 0; run.due >= dt && n < 40 && run.k < run.reference.last; n++, run.due -= dt) step();
    run.due = Math.min(run.due, dt);
  }

  const mixed = (a, b, share) => a + share * (b - a);

  function scene() {
    const share = Math.min(run.due / speed_range().dt, 1), k = run.k;
    const before = run.reference.row(Math.max(k - 1, 0)), now = run.reference.row(k);
    const shown = run.vehicles.filter((v) => chosen.on.has(v.name)).map(({ name, vehicle, trail }) => {
      const [a, b] = [vehicle.before, vehicle.plant];
      const place = held ? [held.x, held.y] : [mixed(a[0], b[0], share), mixed(a[1], b[1], share)];
      return { name, colour: KINDS[name].colour, trail, x: place[0], y: place[1], psi: mixed(a[2], b[2], share) };
    });
    const s = run.sea.sample, at = DATA.at.sample;
    return {
      view, vehicles: shown, path: run.reference, k, time: performance.now() / 1000, speed: speed_range().speed, waves: settings.waves,
      length: LENGTH[chosen.speed_range], current: [s[at.V_x], s[at.V_y]],
      reference: [0, 1, 2].map((i) => mixed(before[i], now[i], share)),
    };
  }

  // The camera follows the reference, and zooms out to show all vehicles, up to a limit.
  function look(picture, seconds) {
    const [x, y] = picture.reference, least = chosen.speed_range === "cruise" ? 11 : 3.2, most = 6 * least;
    const reach = picture.vehicles.map((v) => Math.max(Math.abs(v.x - x) * (view.h / view.w), Math.abs(v.y - y)));
    const half = Math.min(Math.max(least, ...reach.map((d) => 1.25 * d + 0.15 * least)), most);
    const share = held ? 0 : 1 - Math.exp(-seconds / 0.35);
    if (!view.ready) { Object.assign(view, { x, y, scale: view.h / 2 / half, ready: true }); return; }
    view.x += share * (x - view.x);
    view.y += share * (y - view.y);
    view.scale += share * (view.h / 2 / half - view.scale);
  }

  function paint() {
    const picture = scene(), ekf = run.vehicles.find((v) => v.name === "ekf"), e = DATA.at.estimate;
    DRAWING.sea($("sea"), picture);
    const z = ekf.vehicle.controller.estimate, estimated = chosen.on.has("ekf") ? [z[e.V_x], z[e.V_y]] : null;
    DRAWING.rose($("rose"), picture.current, estimated, 0.6 * speed_range().speed, KINDS.ekf.colour);
    $("rosetext").textContent = `current ${Math.hypot(...picture.current).toFixed(2)} m/s` + (estimated ? `, estimated ${Math.hypot(...estimated).toFixed(2)}` : "");
    const t = Math.min(run.k * speed_range().dt, DATA.steps * speed_range().dt);
    $("clock").textContent = run.over ? `${t.toFixed(0)} s: done, a new episode follows` : `${t.toFixed(1)} s of ${DATA.steps * speed_range().dt} s, episode ${chosen.seed + 1}`;
    if (stats.frames % 4) return; // numbers and charts are updated every fourth frame
    for (const each of run.vehicles) card(each);
    const lines = run.vehicles.filter((v) => chosen.on.has(v.name)).map((v) => ({ colour: KINDS[v.name].colour, points: v.points }));
    DRAWING.errors($("errors"), lines, DATA.steps * speed_range().dt, run.marks);
  }

  const metres = (x) => (x < 1 ? `${(100 * x).toFixed(x < 0.1 ? 1 : 0)} cm` : `${x.toFixed(2)} m`);

  function card({ name, vehicle, points, squares }) {
    const on = chosen.on.has(name), parts = cards[name], { controller } = vehicle, e = DATA.at.estimate;
    parts.now.textContent = on ? metres(points[points.length - 1][1]) : "off";
    const mean = Math.sqrt(squares.reduce((a, b) => a + b, 0) / Math.max(squares.length, 1));
    parts.mean.textContent = on && squares.length ? `${metres(mean)} over ${WINDOW} s` : "";
    DRAWING.commands(parts.bars, on ? vehicle.action : [0, 0], on ? controller.base : null, KINDS[name].colour);
    const z = controller.estimate, a = controller.correction;
    parts.note.textContent = !on ? "" : z ? `load ${z[e.X].toFixed(0)}, ${z[e.Y].toFixed(0)} N, lag ${z[e.lag].toFixed(1)} s`
      : a ? `adds ${percent(a[0] * controller.authority[0])}, ${percent(a[1] * controller.authority[1])}` : "";
  }

  const percent = (x) => `${x < 0 ? "\u2212" : "+"}${Math.abs(100 * x).toFixed(0)} %`;

  function frame(now) {
    const seconds = since === null ? 0 : Math.min((now - since) / 1000, 0.1), start = performance.now();
    since = now;
    if (playing) {
      advance(seconds);
      DRAWING.drift([run.sea.sample[DATA.at.sample.V_x], run.sea.sample[DATA.at.sample.V_y]], seconds * chosen.speed, view);
    }
    look(scene(), seconds);
    paint();
    const cost = performance.now() - start;
    stats.frames += 1;
    stats.milliseconds += cost;
    stats.slowest = Math.max(stats.slowest, cost);
    requestAnimationFrame(frame);
  }

  function button(parent, text, title, action) {
    const made = document.createElement("button");
    made.textContent = text;
    made.title = title;
    made.addEventListener("click", action);
    parent.append(made);
    return made;
  }

  // A row of buttons of which one is chosen.
  function choice(parent, names, current, pick) {
    const made = Object.entries(names).map(([name, text]) => [name, button(parent, text, "", () => { pick(name); sync(); })]);
    return () => made.forEach(([name, b]) => b.setAttribute("aria-pressed", String(name === current())));
  }

  const cards = {}, syncs = [];

  function preset(name) {
    const { current, gust, waves, noise, mismatch, actuator } = speed_range().cases[name];
    Object.assign(settings, { current, gusts: gust, waves, noise, direction: own().direction });
    Object.assign(chosen, { preset: name, mismatch, actuator });
    begin();
  }

  function sync() { syncs.forEach((each) => each()); share(); }

  function build() {
    for (const [name, kind] of Object.entries(KINDS)) {
      const b = button($("cards"), "", "Show or hide", () => { toggle(chosen.on, name); sync(); });
      b.className = "card";
      b.dataset.controller = name;
      b.style.setProperty("--own", kind.colour);
      const add = (tag, cls, text = "") => { const x = document.createElement(tag); x.className = cls; x.textContent = text; b.append(x); return x; };
      add("b", "", kind.title); add("small", "", kind.text);
      cards[name] = { now: add("span", "now"), mean: add("span", "mean"), bars: add("canvas", "bars"), note: add("div", "note") };
      syncs.push(() => b.setAttribute("aria-pressed", String(chosen.on.has(name))));
    }
    syncs.push(choice($("cases"), CASES, () => chosen.preset, preset));
    for (const [key, text, low, high, by, shown] of SLIDERS) slider(key, text, low, high, by, shown);
    for (const [key, text] of TOGGLES) tick(key, text);
    const titles = Object.fromEntries(Object.entries(speed_range().paths).map(([name, p]) => [name, p.title]));
    syncs.push(choice($("paths"), titles, () => chosen.family, (name) => { chosen.family = name; begin(); }));
    syncs.push(choice($("speed_ranges"), SPEED_RANGES, () => chosen.speed_range, (name) => { chosen.speed_range = name; view.ready = false; preset(chosen.preset || "storm"); }));
    const speeds = Object.fromEntries(SPEEDS.map((s) => [s, `${s}\u00d7`]));
    syncs.push(choice($("speeds"), speeds, () => String(chosen.speed), (s) => { chosen.speed = Number(s); }));
    $("play").addEventListener("click", play);
    $("restart").addEventListener("click", begin);
    $("reseed").addEventListener("click", reseed);
    document.addEventListener("keydown", keys);
    document.addEventListener("keydown", steer);
    document.addEventListener("keyup", steer);
    window.addEventListener("blur", () => ENGINE.hand.fill(0)); // the keyup goes to another window
    grab($("sea"));
    for (const [text, address] of Object.entries(window.LINKS || {})) {
      const a = Object.assign(document.createElement("a"), { href: address, textContent: text });
      $("links").append(a, " ");
    }
  }

  function toggle(set, name) { if (!set.delete(name)) set.add(name); }

  function slider(key, text, low, high, by, shown) {
    const label = document.createElement("label"), input = document.createElement("input"), output = document.createElement("output");
    label.className = "slider";
    Object.assign(input, { type: "range", min: low, max: high, step: by, id: `slider-${key}` });
    label.append(text, output, input);
    input.addEventListener("input", () => { settings[key] = Number(input.value); chosen.preset = ""; sync(); });
    $("sliders").append(label);
    syncs.push(() => { input.value = settings[key]; output.textContent = shown(settings[key], speed_range()); });
  }

  function tick(key, text) {
    const label = document.createElement("label"), input = document.createElement("input");
    label.className = "tick";
    Object.assign(input, { type: "checkbox", id: `toggle-${key}` });
    label.append(input, text);
    input.addEventListener("change", () => { chosen[key] = input.checked; chosen.preset = ""; begin(); sync(); });
    $("toggles").append(label);
    syncs.push(() => { input.checked = chosen[key]; });
  }

  function play() {
    playing = !playing;
    $("play").textContent = playing ? "\u275a\u275a" : "\u25b6";
    $("play").setAttribute("aria-label", playing ? "Pause" : "Continue");
  }

  function reseed() {
    chosen.seed += 1;
    settings.direction = own().direction;
    begin();
    sync();
  }

  // The arrow keys steer the vehicle "you".
  const ARROWS = { ArrowUp: [0, 1], ArrowDown: [0, -1], ArrowLeft: [1, 1], ArrowRight: [1, -1] };
  function steer(event) {
    const arrow = ARROWS[event.key];
    if (!arrow) return;
    if (event.type === "keyup") { ENGINE.hand[arrow[0]] = 0; return; }
    if (!chosen.on.has("you") || event.target.tagName === "INPUT") return;
    ENGINE.hand[arrow[0]] = arrow[1];
    event.preventDefault();
  }

  // The state of the page in the address, so that a link shows the same episode.
  const SHARED = ["speed_range", "family", "seed", "preset", "mismatch", "actuator"];
  function share() {
    const state = Object.fromEntries(SHARED.map((name) => [name, chosen[name]]));
    const words = new URLSearchParams({ ...state, on: [...chosen.on].join(" ") });
    if (!chosen.preset) for (const [name] of SLIDERS) words.set(name, settings[name]);
    history.replaceState(null, "", `#${words}`);
  }

  // Takes over the state of the address, and begins an episode; unknown words are ignored.
  function load() {
    const words = new URLSearchParams(location.hash.slice(1)), given = (name, allowed) => allowed.includes(words.get(name));
    if (given("speed_range", Object.keys(DATA.speed_ranges))) chosen.speed_range = words.get("speed_range");
    if (given("family", Object.keys(speed_range().paths))) chosen.family = words.get("family");
    if (/^\d{1,6}$/.test(words.get("seed"))) chosen.seed = Number(words.get("seed"));
    if (words.has("on")) chosen.on = new Set(words.get("on").split(" ").filter((name) => name in KINDS));
    preset(given("preset", Object.keys(CASES)) ? words.get("preset") : "storm");
    if (words.get("preset") !== "") return;
    for (const [name, , low, high] of SLIDERS) settings[name] = Math.min(Math.max(Number(words.get(name)) || 0, low), high);
    for (const [name] of TOGGLES) chosen[name] = words.get(name) === "true";
    chosen.preset = "";
    begin();
  }

  function keys(event) {
    const action = { " ": play, r: begin, n: reseed }[event.key.toLowerCase()];
    if (action && !event.ctrlKey && !event.metaKey && !/^(INPUT|BUTTON)$/.test(event.target.tagName)) {
      action();
      event.preventDefault();
    }
  }

  function grab(canvas) {
    const place = (event) => {
      const box = canvas.getBoundingClientRect();
      return { x: view.x + (event.clientX - box.left - box.width / 2) / view.scale, y: view.y - (event.clientY - box.top - box.height / 2) / view.scale };
    };
    const move = (event) => { if (held) { held = place(event); run.vehicles.forEach((v) => pin(v.vehicle)); } };
    const release = () => {
      if (held) for (const { vehicle } of run.vehicles) vehicle.restart(Float64Array.from(run.sea.sample));
      held = null;
      canvas.classList.remove("held");
    };
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      held = place(event);
      canvas.classList.add("held");
      run.marks.push([run.k * speed_range().dt, run.k * speed_range().dt]);
      move(event);
      if (!touched) { touched = true; $("hint").classList.add("gone"); }
    });
    canvas.addEventListener("pointermove", move);
    canvas.addEventListener("pointerup", release);
    canvas.addEventListener("pointercancel", release);
  }

  build();
  load();
  sync();
  requestAnimationFrame(frame);
  return { stats, chosen, settings, get run() { return run; }, get playing() { return playing; }, view };
})();
