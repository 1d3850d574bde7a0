// A page of figures: each chart is drawn where it belongs, and what is chosen goes to the charts as a parameter.

async function figures(data) {
  const views = [];
  for (const element of document.querySelectorAll("[data-chart]")) {
    const id = element.dataset.chart;
    element.id ||= id.replace(/\W/g, "-");
    views.push(await drawn(element, { ...data.charts[id], datasets: { rows: data.rows[element.dataset.rows ?? id] } }));
  }
  for (const tabs of document.querySelectorAll("[data-param]")) {
    const press = (chosen) => { for (const tab of tabs.children) tab.setAttribute("aria-selected", String(tab === chosen)); };
    tabs.addEventListener("click", async (event) => {
      if (event.target.dataset.value === undefined) return;
      press(event.target);
      for (const view of views) {
        if (tabs.dataset.param in view.getState().signals) await view.signal(tabs.dataset.param, Number(event.target.dataset.value)).runAsync();
      }
    });
    press(tabs.children[Number(tabs.dataset.first ?? 0)]);
  }
  document.documentElement.dataset.ready = "charts";
}

shown(figures);
