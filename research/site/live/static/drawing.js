"use strict";
// Drawing on canvases; it does not change the simulation.
const DRAWING = (() => {
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  let cache = null;
  dark.addEventListener("change", () => { cache = null; });

  function colours() {
    if (!cache) {
      const style = getComputedStyle(document.documentElement);
      cache = Object.fromEntries(
        ["ink", "quiet", "line", "panel", "accent", "water-top", "water-deep"].map((n) => [n, style.getPropertyValue(`--${n}`).trim()]));
      cache.dark = dark.matches;
    }
    return cache;
  }

  // Clears a canvas and sets its resolution to that of the screen. Returns its context, width and height in CSS pixels.
  function sheet(canvas) {
    const ratio = Math.min(window.devicePixelRatio || 1, 2), { clientWidth: w, clientHeight: h } = canvas;
    if (canvas.width !== Math.round(w * ratio) || canvas.height !== Math.round(h * ratio)) {
      canvas.width = Math.round(w * ratio);
      canvas.height = Math.round(h * ratio);
    }
    const g = canvas.getContext("2d");
    g.setTransform(ratio, 0, 0, ratio, 0, 0);
    g.clearRect(0, 0, w, h);
    return { g, w, h };
  }

  function torpedo(g, x, y, heading, size, fill, outline) {
    g.save();
    g.translate(x, y);
    g.rotate(-heading);
    g.beginPath();
    g.moveTo(-size, -0.2 * size);
    g.lineTo(0.55 * size, -0.24 * size);
    g.quadraticCurveTo(size, -0.2 * size, size, 0);
    g.quadraticCurveTo(size, 0.2 * size, 0.55 * size, 0.24 * size);
    g.lineTo(-size, 0.2 * size);
    g.closePath();
    if (fill) { g.fillStyle = fill; g.fill(); }
    g.strokeStyle = outline;
    g.stroke();
    if (fill) {
      g.beginPath(); // fins and propeller
      g.moveTo(-0.75 * size, -0.2 * size); g.lineTo(-1.05 * size, -0.5 * size); g.lineTo(-1.0 * size, -0.15 * size);
      g.moveTo(-0.75 * size, 0.2 * size); g.lineTo(-1.05 * size, 0.5 * size); g.lineTo(-1.0 * size, 0.15 * size);
      g.fill(); g.stroke();
      g.beginPath(); g.moveTo(-1.18 * size, -0.26 * size); g.lineTo(-1.18 * size, 0.26 * size); g.lineWidth = 2; g.stroke();
    }
    g.restore();
  }

  // Particles that drift with the water and show the current.
  const specks = Array.from({ length: 130 }, (_, i) => ({ x: (i * 0.618034) % 1, y: (i * 0.754878) % 1, depth: 0.35 + 0.65 * ((i * 0.3719) % 1) }));

  function drift(current, seconds, view) {
    for (const s of specks) {
      s.x = (((s.x + (current[0] * seconds * s.depth * view.scale) / view.w) % 1) + 1) % 1;
      s.y = (((s.y - (current[1] * seconds * s.depth * view.scale) / view.h) % 1) + 1) % 1;
    }
  }

  function sea(canvas, scene) {
    const { g, w, h } = sheet(canvas), c = colours(), { view } = scene;
    Object.assign(view, { w, h });
    const X = (x) => w / 2 + (x - view.x) * view.scale, Y = (y) => h / 2 - (y - view.y) * view.scale;
    const water = g.createLinearGradient(0, 0, 0, h);
    water.addColorStop(0, c["water-top"]);
    water.addColorStop(1, c["water-deep"]);
    g.fillStyle = water;
    g.fillRect(0, 0, w, h);
    grid(g, view, X, Y, c);
    waves(g, w, h, scene, c);
    const [cx, cy] = scene.current, speed = Math.hypot(cx, cy);
    g.lineCap = "round";
    for (const s of specks) {
      const long = Math.min(26, 3 + 40 * (speed / scene.speed) * s.depth), ux = speed ? cx / speed : 1, uy = speed ? cy / speed : 0;
      const x = ((s.x * w - view.x * view.scale * s.depth) % w + w) % w, y = ((s.y * h + view.y * view.scale * s.depth) % h + h) % h;
      g.strokeStyle = c.dark ? `rgb(150 205 240 / ${0.4 * s.depth})` : `rgb(30 95 140 / ${0.36 * s.depth})`;
      g.lineWidth = 0.7 + s.depth;
      g.beginPath(); g.moveTo(x, y); g.lineTo(x - long * ux, y + long * uy); g.stroke();
    }
    path(g, scene, X, Y, c);
    for (const v of scene.vehicles) trail(g, v, X, Y);
    const [x_R, y_R, psi_R] = scene.reference, size = Math.max(11, 0.75 * scene.length * view.scale);
    for (const v of scene.vehicles) {
      g.setLineDash([2, 4]); g.lineWidth = 1.5; g.strokeStyle = v.colour;
      g.beginPath(); g.moveTo(X(x_R), Y(y_R)); g.lineTo(X(v.x), Y(v.y)); g.stroke();
    }
    g.setLineDash([5, 4]); g.lineWidth = 1.8;
    torpedo(g, X(x_R), Y(y_R), psi_R, size * 1.25, null, c.ink);
    g.setLineDash([]);
    for (const v of scene.vehicles) {
      g.lineWidth = 1.2;
      torpedo(g, X(v.x), Y(v.y), v.psi, size, v.colour, c.dark ? "#04121c" : "#ffffff");
    }
    scaleBar(g, view, c);
    map(g, scene, c);
  }

  const mapSize = (view) => Math.min(96, view.h / 4);

  // A small map of the whole path.
  function map(g, scene, c) {
    const { rows, last } = scene.path, { view } = scene, xs = [], ys = [], size = mapSize(view);
    for (let k = 0; k <= last; k += 6) { xs.push(rows[8 * k]); ys.push(rows[8 * k + 1]); }
    const [left, right, low, high] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
    const scale = (size - 16) / Math.max(right - left, high - low, 1e-6);
    const X = (x) => 12 + size / 2 + (x - (left + right) / 2) * scale, Y = (y) => 36 + size / 2 - (y - (low + high) / 2) * scale;
    g.save();
    g.beginPath(); g.roundRect(12, 36, size, size, 8); g.fillStyle = c.panel; g.globalAlpha = 0.6; g.fill(); g.globalAlpha = 1; g.clip();
    g.strokeStyle = c.quiet; g.lineWidth = 1.5; g.beginPath();
    xs.forEach((x, i) => g.lineTo(X(x), Y(ys[i])));
    g.stroke();
    for (const v of scene.vehicles) { g.fillStyle = v.colour; g.beginPath(); g.arc(X(v.x), Y(v.y), 2.6, 0, 2 * Math.PI); g.fill(); }
    g.restore();
  }

  function grid(g, view, X, Y, c) {
    const step = niceStep(90 / view.scale), [left, right] = [view.x - view.w / 2 / view.scale, view.x + view.w / 2 / view.scale];
    const [low, high] = [view.y - view.h / 2 / view.scale, view.y + view.h / 2 / view.scale];
    g.strokeStyle = c.dark ? "rgb(255 255 255 / .045)" : "rgb(10 60 100 / .07)";
    g.lineWidth = 1;
    g.beginPath();
    for (let x = Math.ceil(left / step) * step; x < right; x += step) { g.moveTo(X(x), 0); g.lineTo(X(x), view.h); }
    for (let y = Math.ceil(low / step) * step; y < high; y += step) { g.moveTo(0, Y(y)); g.lineTo(view.w, Y(y)); }
    g.stroke();
  }

  function waves(g, w, h, scene, c) {
    if (!scene.waves) return;
    g.strokeStyle = c.dark ? `rgb(140 200 240 / ${0.1 * Math.min(scene.waves, 1.5)})` : `rgb(255 255 255 / ${0.5 * Math.min(scene.waves, 1.4)})`;
    g.lineWidth = 2;
    for (let row = 0; row < 6; row++) {
      g.beginPath();
      const base = ((row + 0.5) * h) / 6;
      for (let x = 0; x <= w; x += 12) {
        const y = base + 6 * scene.waves * Math.sin(x / 70 + 0.8 * scene.time + 1.7 * row) + 3 * scene.waves * Math.sin(x / 31 - 1.1 * scene.time + row);
        if (x) g.lineTo(x, y); else g.moveTo(x, y);
      }
      g.stroke();
    }
  }

  function path(g, scene, X, Y, c) {
    const { rows, last } = scene.path, now = Math.min(scene.k, last);
    for (const [from, to, alpha, width] of [[0, now, 0.25, 1.5], [now, last, 0.75, 2]]) {
      g.beginPath();
      for (let k = from; k <= to; k += 2) g.lineTo(X(rows[8 * k]), Y(rows[8 * k + 1]));
      g.strokeStyle = c.ink; g.globalAlpha = alpha; g.lineWidth = width;
      g.setLineDash(from ? [1, 7] : []);
      g.stroke();
    }
    g.setLineDash([]);
    g.globalAlpha = 1;
  }

  function trail(g, v, X, Y) {
    g.lineWidth = 2.4; g.strokeStyle = v.colour; g.globalAlpha = 0.6;
    g.beginPath();
    for (const p of v.trail) if (p) g.lineTo(X(p[0]), Y(p[1])); else { g.stroke(); g.beginPath(); }
    g.lineTo(X(v.x), Y(v.y));
    g.stroke();
    g.globalAlpha = 1;
  }

  function niceStep(wanted) {
    const power = 10 ** Math.floor(Math.log10(wanted)), part = wanted / power;
    return power * (part < 1.5 ? 1 : part < 3.5 ? 2 : part < 7.5 ? 5 : 10);
  }

  function scaleBar(g, view, c) {
    const metres = niceStep(70 / view.scale), x = 14, y = 36 + mapSize(view) + 26;
    g.strokeStyle = c.ink; g.fillStyle = c.ink; g.lineWidth = 1.5; g.font = "12px system-ui, sans-serif";
    g.beginPath(); g.moveTo(x, y - 4); g.lineTo(x, y); g.lineTo(x + metres * view.scale, y); g.lineTo(x + metres * view.scale, y - 4); g.stroke();
    g.fillText(`${+metres.toPrecision(2)} m`, x + 4, y - 7);
  }

  function arrow(g, x, y, dx, dy, colour, width, dash) {
    const long = Math.hypot(dx, dy);
    if (long < 1.5) return;
    const [ux, uy] = [dx / long, dy / long], head = Math.min(9, 0.6 * long + 2);
    g.strokeStyle = g.fillStyle = colour; g.lineWidth = width; g.setLineDash(dash || []);
    g.beginPath(); g.moveTo(x, y); g.lineTo(x + dx - ux * head * 0.7, y + dy - uy * head * 0.7); g.stroke();
    g.setLineDash([]);
    g.beginPath(); g.moveTo(x + dx, y + dy);
    g.lineTo(x + dx - head * (ux + 0.45 * uy), y + dy - head * (uy - 0.45 * ux));
    g.lineTo(x + dx - head * (ux - 0.45 * uy), y + dy - head * (uy + 0.45 * ux));
    g.closePath(); g.fill();
  }

  // The true current, and the estimate of the filter.
  function rose(canvas, current, estimated, largest, colour) {
    const { g, w, h } = sheet(canvas), c = colours(), r = w / 2 - 6;
    g.fillStyle = c.panel; g.globalAlpha = 0.72;
    g.beginPath(); g.arc(w / 2, h / 2, r + 4, 0, 2 * Math.PI); g.fill(); g.globalAlpha = 1;
    g.strokeStyle = c.line; g.lineWidth = 1;
    for (const share of [0.5, 1]) { g.beginPath(); g.arc(w / 2, h / 2, share * r, 0, 2 * Math.PI); g.stroke(); }
    const scaled = ([x, y]) => { const m = Math.max(1, Math.hypot(x, y) / largest); return [(x / largest / m) * r, (-y / largest / m) * r]; };
    arrow(g, w / 2, h / 2, ...scaled(current), c.accent, 5);
    if (estimated) arrow(g, w / 2, h / 2, ...scaled(estimated), colour, 2.5, [4, 3]);
  }

  // Two bars from -1 to 1: the commands of surge and yaw. For an agent they have the part of the expert in grey.
  function commands(canvas, action, base, colour) {
    const { g, w, h } = sheet(canvas), c = colours(), left = 48, mid = left + (w - left) / 2, half = (w - left) / 2 - 2;
    g.font = "12px system-ui, sans-serif"; g.textBaseline = "middle";
    ["thrust", "rudder"].forEach((name, i) => {
      const y = 11 + 23 * i, end = mid + half * action[i];
      g.fillStyle = c.quiet; g.fillText(name, 0, y);
      g.fillStyle = c.line; g.fillRect(left, y - 6, w - left, 12);
      const from = base ? mid + half * base[i] : mid;
      if (base) { g.fillStyle = c.quiet; g.globalAlpha = 0.55; g.fillRect(Math.min(mid, from), y - 6, Math.abs(from - mid), 12); g.globalAlpha = 1; }
      g.fillStyle = colour; g.fillRect(Math.min(from, end), base ? y - 3 : y - 6, Math.max(Math.abs(end - from), 1), base ? 6 : 12);
      g.fillStyle = c.ink; g.fillRect(end - 1, y - 8, 2, 16); g.fillStyle = c.quiet; g.fillRect(mid - 0.5, y - 6, 1, 12);
    });
  }

  // Errors over time on a logarithmic scale, a centimetre to ten metres.
  function errors(canvas, lines, duration, marks) {
    const { g, w, h } = sheet(canvas), c = colours(), left = 46, bottom = 20, top = 6;
    const X = (t) => left + ((w - left - 6) * t) / duration;
    const Y = (e) => top + (h - top - bottom) * (1 - (Math.log10(Math.min(Math.max(e, 0.005), 30)) - Math.log10(0.005)) / Math.log10(30 / 0.005));
    g.font = "12px system-ui, sans-serif"; g.textBaseline = "middle"; g.lineWidth = 1;
    for (const [e, text] of [[0.01, "1 cm"], [0.1, "10 cm"], [1, "1 m"], [10, "10 m"]]) {
      g.strokeStyle = c.line; g.beginPath(); g.moveTo(left, Y(e)); g.lineTo(w - 6, Y(e)); g.stroke();
      g.fillStyle = c.quiet; g.textAlign = "right"; g.fillText(text, left - 6, Y(e));
    }
    g.textAlign = "center";
    for (let t = 0; t <= duration + 0.01; t += duration / 6) g.fillText(`${Math.round(t)} s`, Math.min(X(t), w - 16), h - 8);
    g.fillStyle = c.accent; g.globalAlpha = 0.14;
    for (const [from, to] of marks) g.fillRect(X(from), top, Math.max(X(to) - X(from), 2), h - top - bottom);
    g.globalAlpha = 1;
    g.lineJoin = "round"; g.lineWidth = 2;
    for (const { colour, points } of lines) {
      g.strokeStyle = colour; g.beginPath();
      for (const [t, e] of points) g.lineTo(X(t), Y(e));
      g.stroke();
    }
    g.textAlign = "left";
  }

  return { sea, rose, commands, errors, drift };
})();
