// The report of an evaluation: the selected policies, the selected scenario, and their charts.

const $ = (id) => document.getElementById(id);

function report(data) {
  const chosen = new Set(data.policies.filter((p) => p.on).map((p) => p.name));
  const looks = new Map(data.policies.map((p) => [p.name, p]));
  const views = {};
  let scenario = 0;
  const visible = (rows) => rows.filter((row) => chosen.has(row.policy));

  /** Draw a chart, or replace the rows of a chart that exists. */
  async function chart(id, element, rows, others = {}, values = {}) {
    const key = element.id;
    if (!views[key]) {
      const spec = structuredClone(data.charts[id]);
      for (const param of spec.params ?? []) if (param.name in values) param.value = values[param.name];
      spec.datasets = { rows, ...others };
      views[key] = drawn(element, spec);
      await views[key];
      return;
    }
    const view = await views[key];
    view.data("rows", rows);
    for (const [name, value] of Object.entries(others)) view.data(name, value);
    for (const [name, value] of Object.entries(values)) view.signal(name, value);
    await view.runAsync();
  }

  /** Draw the scores of all cases, a chart for each speed range. */
  async function scores() {
    const box = $("scores");
    if (!box) return;
    for (const speed_range of new Set(data.scenarios.map((s) => s.speed_range).filter(Boolean))) {
      const own = data.scenarios.filter((s) => s.speed_range === speed_range);
      const rows = own.flatMap((s) => visible(s.rows).filter((r) => r.score && !["backstepping", "oracle", "clairvoyant"].includes(r.policy)).map((r) => ({ policy: r.policy, case: s.case, failed: r.failed, ...r.score })));
      let element = $(`scores-${speed_range}`);
      if (!element && rows.length === 0) continue;
      if (!element) {
        const figure = document.createElement("figure");
        const caption = document.createElement("figcaption");
        caption.textContent = `${speed_range}: scores with their 95 % intervals`;
        element = document.createElement("div");
        element.id = `scores-${speed_range}`;
        element.className = "chart";
        figure.append(caption, element);
        box.append(figure);
      }
      await chart("scores", element, rows, {}, { least: Math.min(-0.1, ...rows.map((r) => r.low)) });
    }
  }

  async function cell() {
    const s = data.scenarios[scenario];
    if (!s) return;
    const rows = visible(s.rows);
    const steady_rmses = rows.map((r) => ({ policy: r.policy, failed: r.failed, ...r.steady_rmse }));
    const shares = rows.flatMap((r) => r.steady_rmses[0].map((steady_rmse, i) => ({ policy: r.policy, steady_rmse, share: r.steady_rmses[1][i] })));
    const bands = visible(s.bands).flatMap((b) => b.t.map((t, i) => ({ policy: b.policy, t, low: b.low[i], middle: b.middle[i], high: b.high[i] })));
    const caps = s.cap ? [{ cap: s.cap }] : [];
    await chart("steady_rmses", $("steady_rmses"), steady_rmses);
    await chart("shares", $("shares"), shares, { caps });
    $("over-time").hidden = s.bands.length === 0;
    if (s.bands.length) await chart("bands", $("bands"), bands, { steady_rmses: [{ t: s.duration / 3 }] });
  }

  const errors = {
    draw: (rows, now) => chart("errors", $("errors"), rows, {}, { now }),
    mark: async (now) => (await views.errors)?.signal("now", now).runAsync(),
  };
  const stage = player(looks, errors, () => chosen);

  async function update() {
    for (const row of document.querySelectorAll("tr[data-policy]")) {
      const on = chosen.has(row.dataset.policy);
      row.classList.toggle("off", !on);
      const box = row.querySelector("input.switch");
      if (box) box.checked = on;
    }
    $("count").textContent = `${chosen.size} of ${looks.size} shown`;
    await scores();
    await cell();
    await stage.refresh();
  }

  async function choose(index) {
    scenario = (index + data.scenarios.length) % data.scenarios.length;
    const s = data.scenarios[scenario];
    const select = $("scenarios");
    if (select) {
      const option = [...select.options].findIndex((o) => o.textContent === s.name);
      select.selectedIndex = option;
      turned("scenarios", option);
    }
    for (const heading of document.querySelectorAll("th[data-scenario]")) heading.classList.toggle("current", heading.dataset.scenario === s.name);
    await stage.load(s);
    await cell();
  }

  document.addEventListener("change", (event) => {
    if (!event.target.matches("input.switch")) return;
    const name = event.target.closest("tr").dataset.policy;
    if (event.target.checked) chosen.add(name); else chosen.delete(name);
    update();
  });
  for (const button of document.querySelectorAll("[data-show]")) {
    button.addEventListener("click", () => {
      chosen.clear();
      for (const p of data.policies) if (button.dataset.show === "all" || (button.dataset.show === "first" && p.on)) chosen.add(p.name);
      update();
    });
  }
  $("filter").addEventListener("input", (event) => {
    const words = event.target.value.toLowerCase();
    for (const row of document.querySelectorAll(".board tr[data-policy]")) row.classList.toggle("unfound", !row.dataset.policy.toLowerCase().includes(words));
  });
  for (const heading of document.querySelectorAll("th[data-scenario]")) {
    heading.addEventListener("click", () => {
      choose(data.scenarios.findIndex((s) => s.name === heading.dataset.scenario));
      $("scenario").scrollIntoView({ behavior: "smooth" });
    });
  }
  const named = (name) => data.scenarios.findIndex((s) => s.name === name);
  $("scenarios")?.addEventListener("change", (event) => choose(named(event.target.selectedOptions[0].textContent)));
  $("previous")?.addEventListener("click", () => choose(scenario - 1));
  $("next")?.addEventListener("click", () => choose(scenario + 1));

  return (async () => {
    await choose(data.first);
    await update();
    document.documentElement.dataset.ready = "charts";
  })();
}

shown(report);
