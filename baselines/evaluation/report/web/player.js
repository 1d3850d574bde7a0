// Animation of an episode on a canvas: reference, vehicles with their trajectories, and the current. In space a plot of
// the depths over time is below the map.

/** Return the player. `chart` draws the errors and the time; `shown()` returns the set of selected policies. */
function player(looks, chart, shown) {
  const canvas = document.getElementById("sea");
  const pen = canvas.getContext("2d");
  const slider = document.getElementById("time");
  const [clock, button, now] = ["clock", "play", "now"].map((id) => document.getElementById(id));
  let [scenario, episode, t, playing, last, marked] = [null, null, 0, false, 0, -1];

  const end = () => (episode.reference.x.length - 1) * episode.dt;
  const vehicles = () => episode.vehicles.filter((v) => shown().has(v.policy));

  /** Return x, y [m], heading [rad] of a trajectory at a time [s], interpolated. */
  function pose(way, time) {
    const k = Math.min(time / episode.dt, way.x.length - 1);
    const i = Math.min(Math.floor(k), way.x.length - 2);
    if (i < 0) return { x: way.x[0] / 100, y: way.y[0] / 100, psi: way.psi[0] / 100 };
    const s = k - i;
    const mix = (a) => (a[i] + s * (a[i + 1] - a[i])) / 100;
    return { x: mix(way.x), y: mix(way.y), psi: way.psi[i] / 100 + s * wrapped((way.psi[i + 1] - way.psi[i]) / 100) };
  }
  const wrapped = (angle) => Math.atan2(Math.sin(angle), Math.cos(angle));
  const over = (v) => t > (v.x.length - 1) * episode.dt + 1e-9;

  /** Return the scale and the function from metres to pixels, for the whole path or near the reference. */
  function view(width, height) {
    let [x, y, scale] = [0, 0, 1];
    if (document.getElementById("close").checked) {
      const at = pose(episode.reference, t);
      [x, y] = [at.x, at.y];
      const far = Math.max(2, ...vehicles().map((v) => Math.hypot(pose(v, t).x - x, pose(v, t).y - y)));
      scale = (0.4 * Math.min(width, height)) / Math.min(far, 8);
    } else {
      const ways = [episode.reference, ...vehicles()];
      const span = (key) => [Math.min(...ways.flatMap((w) => w[key])) / 100, Math.max(...ways.flatMap((w) => w[key])) / 100];
      const [[x0, x1], [y0, y1]] = [span("x"), span("y")];
      [x, y] = [(x0 + x1) / 2, (y0 + y1) / 2];
      scale = 0.84 * Math.min(width / Math.max(x1 - x0, 1), height / Math.max(y1 - y0, 1));
    }
    return { scale, to: (p) => [width / 2 + scale * (p.x - x), height / 2 - scale * (p.y - y)] };
  }

  function line(way, to, until, style) {
    Object.assign(pen, { strokeStyle: style.colour, lineWidth: style.width, lineCap: "round", lineJoin: "round" });
    pen.setLineDash(style.dash ?? []);
    pen.beginPath();
    const k = Math.min(until / episode.dt, way.x.length - 1);
    for (let i = 0; i <= k; i++) pen.lineTo(...to({ x: way.x[i] / 100, y: way.y[i] / 100 }));
    pen.lineTo(...to(pose(way, until)));
    pen.stroke();
    pen.setLineDash([]);
  }

  function vehicle(at, to, length, colour, faded) {
    const [x, y] = to(at);
    pen.save();
    pen.globalAlpha = faded ? 0.35 : 1;
    pen.translate(x, y);
    pen.rotate(-at.psi);
    pen.beginPath();
    pen.moveTo(0.55 * length, 0);
    pen.quadraticCurveTo(0.45 * length, 0.1 * length, 0.2 * length, 0.1 * length);
    pen.lineTo(-0.35 * length, 0.1 * length);
    pen.lineTo(-0.5 * length, 0);
    pen.lineTo(-0.35 * length, -0.1 * length);
    pen.lineTo(0.2 * length, -0.1 * length);
    pen.quadraticCurveTo(0.45 * length, -0.1 * length, 0.55 * length, 0);
    Object.assign(pen, { fillStyle: colour, strokeStyle: "#fff", lineWidth: 1.5 });
    pen.fill();
    pen.stroke();
    pen.restore();
  }

  function text(words, x, y, align = "left") {
    Object.assign(pen, { font: "12px system-ui, sans-serif", fillStyle: "#1d2733", textAlign: align });
    pen.fillText(words, x, y);
  }

  /** Draw a scale bar, and the current at the first vehicle. */
  function margins(width, height, scale) {
    const most = 90 / scale;
    const unit = 10 ** Math.floor(Math.log10(most));
    const length = [5, 2, 1].map((m) => m * unit).find((m) => m <= most);
    Object.assign(pen, { strokeStyle: "#1d2733", lineWidth: 2 });
    pen.beginPath();
    pen.moveTo(14, height - 14);
    pen.lineTo(14 + scale * length, height - 14);
    pen.stroke();
    text(`${length} m`, 14, height - 20);
    const own = vehicles()[0] ?? episode.vehicles[0];
    const [x, y] = [width - 52, 46];
    if (!own?.current) return text("no current", width - 14, 24, "right");
    const k = Math.min(Math.floor(t / episode.dt), own.current[0].length - 1);
    const [V_x, V_y] = [own.current[0][k], own.current[1][k]];
    const speed = Math.hypot(V_x, V_y);
    const strongest = Math.max(...own.current[0].map((v, i) => Math.hypot(v, own.current[1][i])), 1e-9);
    const [a, b] = [(30 * V_x) / strongest, (-30 * V_y) / strongest];
    Object.assign(pen, { strokeStyle: "#c77700", fillStyle: "#c77700", lineWidth: 4, lineCap: "butt" });
    pen.beginPath();
    pen.moveTo(x - a, y - b);
    pen.lineTo(x + 0.6 * a, y + 0.6 * b);
    pen.stroke();
    pen.beginPath();
    pen.moveTo(x + a, y + b);
    pen.lineTo(x + 0.5 * a - 0.25 * b, y + 0.5 * b + 0.25 * a);
    pen.lineTo(x + 0.5 * a + 0.25 * b, y + 0.5 * b - 0.25 * a);
    pen.fill();
    text(`current ${speed.toFixed(2)} m/s`, width - 14, 96, "right");
  }

  /** Draw the depths of reference and vehicles over time, from a height on. */
  function depths(top, width, height) {
    const ways = [episode.reference, ...vehicles()];
    const all = ways.flatMap((way) => way.depth);
    const [low, high] = [Math.min(...all) / 100 - 0.5, Math.max(...all) / 100 + 0.5];
    const [left, right, lower] = [56, width - 14, height - 22];
    const at = (time, depth) => [left + ((right - left) * time) / end(), top + ((lower - top) * (depth - low)) / (high - low)];
    pen.fillStyle = "#fff";
    pen.fillRect(0, top - 12, width, height);
    const tick = [1, 2, 5, 10, 20, 50, 100].find((m) => (high - low) / m <= 4) ?? 500;
    for (let depth = Math.ceil(low / tick) * tick; depth <= high; depth += tick) {
      const y = at(0, depth)[1];
      pen.fillStyle = "#dde3e8";
      pen.fillRect(left, y, right - left, 1);
      text(`${depth} m`, left - 6, y + 4, "right");
    }
    text("depth", left, height - 6);
    ways.forEach((way, i) => {
      const { colour, dash, width: thick } = i ? { ...looks.get(way.policy), width: 2 } : { colour: "#c9cfd6", width: 5 };
      Object.assign(pen, { strokeStyle: colour, lineWidth: thick });
      pen.setLineDash(dash ?? []);
      pen.beginPath();
      way.depth.forEach((depth, k) => pen.lineTo(...at(k * episode.dt, depth / 100)));
      pen.stroke();
      pen.setLineDash([]);
    });
    pen.fillStyle = "#6b7682";
    pen.fillRect(at(t, 0)[0], top, 1, lower - top);
  }

  function draw() {
    if (!episode) return;
    const ratio = window.devicePixelRatio || 1;
    const [width, whole] = [canvas.clientWidth, canvas.clientHeight];
    const height = episode.reference.depth ? 0.7 * whole : whole;
    if (canvas.width !== Math.round(width * ratio)) [canvas.width, canvas.height] = [Math.round(width * ratio), Math.round(whole * ratio)];
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, whole);
    if (!width) return;
    const { to, scale } = view(width, height);
    line(episode.reference, to, end(), { colour: "#c9cfd6", width: 6 });
    for (const v of vehicles()) {
      const { colour, dash } = looks.get(v.policy);
      line(v, to, Math.min(t, (v.x.length - 1) * episode.dt), { colour, dash, width: 2 });
    }
    const target = to(pose(episode.reference, t));
    Object.assign(pen, { strokeStyle: "#6b7682", lineWidth: 2.5 });
    pen.beginPath();
    pen.arc(...target, 9, 0, 7);
    pen.stroke();
    const length = Math.max(22, Math.min(1.5 * scale, 60));
    for (const v of vehicles()) vehicle(pose(v, t), to, length, looks.get(v.policy).colour, over(v));
    margins(width, height, scale);
    if (episode.reference.depth) depths(height + 12, width, whole);
    clock.textContent = `${t.toFixed(1)} of ${end().toFixed(0)} s`;
    slider.value = t;
    writeErrors();
  }

  /** Write the present errors next to the names of the policies. */
  function writeErrors() {
    for (const item of now.children) {
      const v = episode.vehicles[item.dataset.index];
      const i = Math.min(Math.round(t / episode.dt), v.error.length - 1);
      item.lastChild.textContent = over(v) ? "failed" : `${v.error[i] < 0.1 ? v.error[i].toFixed(3) : v.error[i].toFixed(2)} m`;
    }
  }

  function named() {
    now.replaceChildren(...vehicles().map((v) => {
      const [item, name, value] = ["div", "span", "b"].map((tag) => document.createElement(tag));
      item.dataset.index = episode.vehicles.indexOf(v);
      const row = [...document.querySelectorAll("tr[data-policy]")].find((r) => r.dataset.policy === v.policy);
      const glyph = row?.querySelector(".glyph")?.cloneNode(true);
      name.textContent = `${v.policy}\u00a0`;
      item.append(...(glyph ? [glyph] : []), name, value);
      return item;
    }));
  }

  async function errors() {
    const rows = vehicles().flatMap((v) => v.error.map((error, i) => ({ policy: v.policy, t: i * episode.dt, error })));
    await chart.draw(rows, t);
  }

  /** Move the cursor of the chart, at most about 16 times a second. */
  function mark() {
    const step = Math.floor(performance.now() / 60);
    if (step === marked && playing) return;
    marked = step;
    chart.mark(t);
  }

  function frame(time) {
    if (!playing) return;
    t += (Math.min(time - last, 100) / 1000) * Number(document.getElementById("speed").value);
    last = time;
    if (t >= end()) [t, playing] = [end(), false];
    label();
    draw();
    mark();
    if (playing) requestAnimationFrame(frame);
  }

  function label() {
    button.textContent = playing ? "❚❚ Pause" : "▶ Play";
  }

  button.addEventListener("click", () => {
    playing = !playing;
    if (playing && t >= end()) t = 0;
    last = performance.now();
    label();
    if (playing) requestAnimationFrame(frame);
  });
  slider.addEventListener("input", () => {
    t = Number(slider.value);
    draw();
    mark();
  });
  document.getElementById("close").addEventListener("change", draw);
  window.addEventListener("resize", draw);

  async function show(index) {
    [episode, t, playing] = [scenario.episodes[index], 0, false];
    for (const b of document.getElementById("episodes").children) b.setAttribute("aria-pressed", String(b.dataset.index === String(index)));
    slider.max = end();
    label();
    named();
    draw();
    await errors();
  }

  return {
    /** Load the episodes of a scenario. */
    async load(s) {
      scenario = s;
      document.getElementById("player").hidden = s.episodes.length === 0;
      if (!s.episodes.length) {
        episode = null;
        return;
      }
      document.getElementById("episodes").replaceChildren(...s.episodes.map((_, i) => {
        const b = document.createElement("button");
        b.type = "button";
        b.dataset.index = i;
        b.textContent = `episode ${i + 1}`;
        b.addEventListener("click", () => show(i));
        return b;
      }));
      await show(0);
    },
    /** Draw again after a change of the selected policies. */
    async refresh() {
      if (!episode) return;
      named();
      draw();
      await errors();
    },
  };
}
