"use strict";
(() => {
  const table = document.getElementById("episode-table");
  const body = table.tBodies[0];
  const rows = Array.from(body.rows);
  const policy = document.getElementById("pick-policy");
  const outcome = document.getElementById("pick-outcome");
  const find = document.getElementById("find");
  const count = document.getElementById("count");
  const closer = document.getElementById("closer");
  const stage = document.getElementById("stage");
  document.querySelector(".tools").hidden = false;

  const filter = () => {
    const words = find.value.toLowerCase().split(/\s+/).filter(Boolean);
    let shown = 0;
    for (const row of rows) {
      const text = row.cells[1].textContent.toLowerCase();
      const fits = (!policy || !policy.value || row.dataset.run === policy.value)
        && (!outcome.value || row.dataset.outcome === outcome.value)
        && words.every((word) => text.includes(word));
      row.hidden = !fits;
      shown += fits ? 1 : 0;
    }
    count.textContent = `${shown} of ${rows.length}`;
  };
  for (const control of [policy, outcome]) if (control) control.addEventListener("change", filter);
  find.addEventListener("input", filter);

  const value = (row, key) => {
    const raw = row.dataset[key];
    if (raw === undefined) return null;
    return key === "text" ? raw : Number(raw);
  };
  for (const head of table.tHead.querySelectorAll("th[data-sort]")) {
    head.classList.add("live");
    head.tabIndex = 0;
    const sort = () => {
      const up = head.getAttribute("aria-sort") !== "ascending";
      for (const other of table.tHead.querySelectorAll("th")) other.removeAttribute("aria-sort");
      head.setAttribute("aria-sort", up ? "ascending" : "descending");
      const key = head.dataset.sort;
      rows.sort((a, b) => {
        const x = value(a, key), y = value(b, key);
        if (x === null || y === null) return (x === null ? 0 : 1) - (y === null ? 0 : 1);
        const order = x < y ? -1 : x > y ? 1 : 0;
        return up ? order : -order;
      });
      body.append(...rows);
    };
    head.addEventListener("click", sort);
    head.addEventListener("keydown", (event) => {
      if (event.key === "Enter" || event.key === " ") { event.preventDefault(); sort(); }
    });
  }

  const open = (row, watch) => {
    stage.replaceChildren();
    const task = row.cells[1].cloneNode(true);
    for (const button of task.querySelectorAll("button")) button.remove();
    const title = document.createElement("div");
    title.className = "task";
    title.append(...task.childNodes);
    stage.append(title);
    if (watch) {
      const clip = document.querySelector(`video[data-clip="${row.dataset.clip}"]`);
      if (clip) {
        const copy = clip.cloneNode();
        copy.removeAttribute("data-clip");
        stage.append(copy);
        copy.play().catch(() => {});
      }
    }
    for (const map of row.querySelectorAll(".map svg")) {
      stage.append(map.cloneNode(true));
      if (watch) break;
    }
    closer.showModal();
  };
  for (const row of rows) {
    row.classList.add("live");
    for (const map of row.querySelectorAll(".map svg")) map.addEventListener("click", () => open(row, false));
    for (const play of row.querySelectorAll(".play")) {
      play.hidden = false;
      play.addEventListener("click", () => open(row, true));
    }
  }
  document.getElementById("close").addEventListener("click", () => closer.close());
  closer.addEventListener("click", (event) => { if (event.target === closer) closer.close(); });
  closer.addEventListener("close", () => stage.replaceChildren());
  filter();
})();
