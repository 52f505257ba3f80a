"use strict";
(() => {
  // an episode is a row of the table of goals, or a body of two rows of the table of following
  const list = document.getElementById("episode-list");
  const rows = Array.from(list.querySelectorAll("[data-run]"));
  const policy = document.getElementById("pick-policy");
  const outcome = document.getElementById("pick-outcome");
  const find = document.getElementById("find");
  const count = document.getElementById("count");
  const closer = document.getElementById("closer");
  const stage = document.getElementById("stage");
  document.querySelector(".tools").hidden = false;

  const textOf = (row) => Array.from(
    row.querySelectorAll(".task span"), (span) => span.textContent.toLowerCase(),
  ).join(" ");
  const filter = () => {
    const words = find.value.toLowerCase().split(/\s+/).filter(Boolean);
    let shown = 0;
    for (const row of rows) {
      const text = words.length ? textOf(row) : "";
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
  for (const head of list.querySelectorAll("th[data-sort]")) {
    const table = head.closest("table");
    const own = rows.filter((row) => table.contains(row));
    head.classList.add("live");
    head.tabIndex = 0;
    const sort = () => {
      const up = head.getAttribute("aria-sort") !== "ascending";
      for (const other of table.tHead.querySelectorAll("th")) other.removeAttribute("aria-sort");
      head.setAttribute("aria-sort", up ? "ascending" : "descending");
      const key = head.dataset.sort;
      own.sort((a, b) => {
        const x = value(a, key), y = value(b, key);
        if (x === null || y === null) return (x === null ? 0 : 1) - (y === null ? 0 : 1);
        const order = x < y ? -1 : x > y ? 1 : 0;
        return up ? order : -order;
      });
      own[0]?.parentNode.append(...own);
    };
    head.addEventListener("click", sort);
    head.addEventListener("keydown", (event) => {
      if (event.key === "Enter" || event.key === " ") { event.preventDefault(); sort(); }
    });
  }

  // The command that opens an episode: run folders are told as seen from this page, so that they
  // are right wherever the folder lies now.
  const viewer = document.getElementById("viewer");
  const command = document.getElementById("command");
  const address = document.getElementById("address");
  const deep = document.getElementById("deep");
  const windows = /^\/[A-Za-z]:\//.test(location.pathname);
  const quote = (word) => {
    if (/^[\w@%+=:,./-]+$/.test(word)) return word;
    return windows ? `"${word.replaceAll('"', '""')}"` : `'${word.replaceAll("'", "'\\''")}'`;
  };
  const placeOf = (way) => {
    if (location.protocol !== "file:" || /^(\/|[A-Za-z]:)/.test(way)) return way;
    const parts = decodeURIComponent(location.pathname).split("/").slice(windows ? 1 : 0, -1);
    for (const part of way.split("/")) {
      if (part === "..") parts.pop();
      else if (part !== ".") parts.push(part);
    }
    return parts.join("/") || "/";
  };
  // no sign that a terminal acts on, and on Windows none that its shells expand between quotes
  const isPlain = (text) => !(windows && /["$`%!]/.test(text)) && !/[\u0000-\u001f\u007f-\u009f\u2028\u2029]/.test(text);
  const link = () => {
    deep.hidden = true;
    deep.removeAttribute("href");
    let found = null;
    try { found = new URL(address.value.trim()); } catch { return; }
    if (found.protocol !== "http:" && found.protocol !== "https:") return;
    found.searchParams.set("episode", viewer.dataset.episode);
    deep.href = found.href;
    deep.hidden = false;
  };
  const offer = (row) => {
    const folders = JSON.parse(list.dataset.folders).map(placeOf);
    const places = folders.map((folder) => (folder.startsWith("-") ? `./${folder}` : folder));
    const words = ["gn0", "view", ...places, `--episode=${row.dataset.text}`];
    viewer.hidden = !row.querySelector(".view") || !words.every(isPlain);
    if (viewer.hidden) return;
    viewer.dataset.episode = row.dataset.text;
    command.textContent = words.map(quote).join(" ");
    link();
  };
  address.addEventListener("input", link);
  document.getElementById("copy").addEventListener("click", async (event) => {
    try {
      await navigator.clipboard.writeText(command.textContent);
    } catch {
      getSelection().selectAllChildren(command);
      document.execCommand("copy");
    }
    event.target.textContent = "copied";
  });

  const open = (row, watch) => {
    stage.replaceChildren();
    const task = row.querySelector(".task").cloneNode(true);
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
      const large = map.cloneNode(true);
      large.setAttribute("viewBox", large.dataset.whole);
      for (const north of large.querySelectorAll(".north")) north.remove();
      stage.append(large);
      if (watch) break;
    }
    offer(row);
    closer.showModal();
  };
  for (const row of rows) {
    row.classList.add("live");
    for (const map of row.querySelectorAll(".map svg")) map.addEventListener("click", () => open(row, false));
    for (const view of row.querySelectorAll(".view")) {
      view.hidden = false;
      view.addEventListener("click", () => open(row, false));
    }
    for (const play of row.querySelectorAll(".play")) {
      play.hidden = false;
      play.addEventListener("click", () => open(row, true));
    }
  }
  document.getElementById("close").addEventListener("click", () => closer.close());
  closer.addEventListener("click", (event) => { if (event.target === closer) closer.close(); });
  closer.addEventListener("close", () => {
    stage.replaceChildren();
    document.getElementById("copy").textContent = "copy";
  });
  filter();
})();
