"use strict";
(() => {
  const root = document.documentElement;
  const inflate = async (id) => {
    const packed = Uint8Array.from(atob(document.getElementById(id).textContent), (c) => c.charCodeAt(0));
    return new Response(new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"))).text();
  };

  // Colours are written as "@name" and resolved from the style sheet, so that figures follow the light and dark scheme.
  const resolve = (value, style) => {
    if (typeof value === "string" && value.startsWith("@")) return style.getPropertyValue("--" + value.slice(1)).trim();
    if (Array.isArray(value)) return value.length && typeof value[0] === "object" ? value.map((v) => resolve(v, style)) : value;
    if (value && typeof value === "object") {
      return Object.fromEntries(Object.entries(value).map(([k, v]) => [k, resolve(v, style)]));
    }
    return value;
  };

  const AXIS = { gridcolor: "@grid", zerolinecolor: "@grid", linecolor: "@muted", automargin: true, ticks: "outside", tickcolor: "@grid" };
  const titled = (axis) => axis.title ? { ...axis, title: { standoff: 8, font: { size: 13 }, ...axis.title } } : axis;
  const themed = (figure) => {
    const style = getComputedStyle(root);
    const layout = {
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", autosize: true,
      font: { family: style.getPropertyValue("--font"), size: 13, color: "@text" },
      margin: { l: 56, r: 14, t: 32, b: 44 },
      legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0 },
      modebar: { bgcolor: "rgba(0,0,0,0)", color: "@muted", activecolor: "@accent" },
      hoverlabel: { bgcolor: "@panel", bordercolor: "@grid", font: { color: "@text" } },
      ...figure.layout,
    };
    for (const key of ["xaxis", "yaxis"]) layout[key] = titled({ ...AXIS, ...(layout[key] || {}) });
    if (layout.scene) {
      const scene = { ...layout.scene, bgcolor: "rgba(0,0,0,0)" };
      for (const key of ["xaxis", "yaxis", "zaxis"]) scene[key] = { gridcolor: "@grid", zerolinecolor: "@grid", ...titled(scene[key] || {}) };
      layout.scene = scene;
      if (innerWidth < 600) layout.legend = { ...layout.legend, y: 0, yanchor: "top" };  // its buttons need the upper line
      layout.margin = { l: 0, r: 0, t: 14, b: 0 };
      delete layout.xaxis;
      delete layout.yaxis;
    }
    return resolve({ data: figure.data, layout }, style);
  };

  const save = (name, blob) => {
    const link = document.createElement("a");
    link.download = name;
    link.href = URL.createObjectURL(blob);
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  };
  const stem = (place) => `${document.title.split(" ")[0]}-${place.id}`;
  // What is drawn, as a table: name, x, y (z) of every trace.
  const asCsv = (figure) => {
    const quoted = (v) => v === null || v === undefined ? "" : /[",\n]/.test(String(v)) ? `"${String(v).replace(/"/g, '""')}"` : String(v);
    const rows = [["trace", "x", "y", "z"]];
    for (const trace of figure.data) {
      const n = Math.max((trace.x || []).length, (trace.y || []).length);
      for (let i = 0; i < n; i++) rows.push([trace.name, trace.x && trace.x[i], trace.y && trace.y[i], trace.z && trace.z[i]]);
    }
    return rows.map((row) => row.map(quoted).join(",")).join("\n") + "\n";
  };
  const DOWN = { width: 24, height: 24, path: "M11 3h2v9h4l-5 5-5-5h4zM4 19h16v2H4z" };
  const saver = (format, figures) => ({
    name: `save ${format.toUpperCase()}`, title: `Save as ${format.toUpperCase()}`, icon: DOWN,
    click: async (place) => {
      if (format === "csv") return save(`${stem(place)}.csv`, new Blob([asCsv(figures[place.id])], { type: "text/csv" }));
      const size = { width: place.clientWidth, height: place.clientHeight, scale: format === "png" ? 3 : 1 };
      const url = await Plotly.toImage(place, { format, ...size });
      const [head, data] = url.split(/,(.*)/s);
      const bytes = head.includes("base64") ? Uint8Array.from(atob(data), (c) => c.charCodeAt(0)) : decodeURIComponent(data);
      save(`${stem(place)}.${format}`, new Blob([bytes], { type: format === "svg" ? "image/svg+xml" : "image/png" }));
    },
  });

  // Tables are copied as tab-separated values, for a spreadsheet, and as LaTeX, for a paper.
  const cells = (table) => [...table.rows].map((row) => [...row.cells].map((cell) => cell.innerText.trim().replace(/\s*\n\s*/g, " ")));
  const asLatex = (table) => {
    const escaped = (t) => t.replace(/\\/g, "\\textbackslash{}").replace(/[&%$#_{}]/g, "\\$&").replace(/±/g, "$\\pm$").replace(/−/g, "$-$").replace(/²/g, "$^2$").replace(/³/g, "$^3$").replace(/⁻/g, "$^-$").replace(/°/g, "$^\\circ$");
    const [head, ...rows] = cells(table).map((row) => row.map(escaped).join(" & ") + " \\\\");
    return ["\\begin{tabular}{l" + "r".repeat(table.rows[0].cells.length - 1) + "}", "\\hline", head, "\\hline", ...rows, "\\hline", "\\end{tabular}", ""].join("\n");
  };
  const asTsv = (table) => cells(table).map((row) => row.join("\t")).join("\n") + "\n";
  document.querySelectorAll(".scroll").forEach((place) => {
    const table = place.querySelector("table");
    const line = document.createElement("div");
    line.className = "copies";
    for (const [name, write] of [["TSV", asTsv], ["LaTeX", asLatex]]) {
      const button = document.createElement("button");
      button.type = "button";
      button.textContent = `copy as ${name}`;
      button.addEventListener("click", async () => {
        try {
          await navigator.clipboard.writeText(write(table));
          button.textContent = `copied as ${name}`;
        } catch {
          save(`table.${name === "TSV" ? "tsv" : "tex"}`, new Blob([write(table)], { type: "text/plain" }));
        }
        setTimeout(() => { button.textContent = `copy as ${name}`; }, 1500);
      });
      line.append(button);
    }
    place.append(line);
  });
  const folds = [...document.querySelectorAll("details.fold")];
  if (folds.length) {
    const line = document.createElement("p");
    line.className = "folds";
    for (const [text, open] of [["open all sections", true], ["fold all", false]]) {
      const button = document.createElement("button");
      button.type = "button";
      button.textContent = text;
      button.addEventListener("click", () => folds.forEach((fold) => { fold.open = open; }));
      line.append(button);
    }
    document.querySelector("main").prepend(line);
  }
  const unfold = () => {
    if (location.hash === "#all") folds.forEach((each) => { each.open = true; });
    const target = location.hash && document.getElementById(location.hash.slice(1));
    const fold = target && target.querySelector("details.fold");
    if (fold) fold.open = true;
  };
  addEventListener("hashchange", unfold);
  unfold();

  const CONFIG = {
    responsive: true, displaylogo: false, displayModeBar: "hover", showSendToCloud: false, plotlyServerURL: "",
    modeBarButtonsToRemove: ["select2d", "lasso2d", "toImage", "autoScale2d", "tableRotation", "resetCameraLastSave3d"],
  };
  const webgl = () => {
    const canvas = document.createElement("canvas");
    return Boolean(canvas.getContext("webgl2") || canvas.getContext("webgl"));
  };

  // Figures over the flight's time zoom together; the others keep their own vertical range.
  const timed = new Set();
  let following = false;
  const follow = (place) => {
    timed.add(place);
    place.on("plotly_relayout", async (change) => {
      if (following) return;
      const range = change["xaxis.range"] || (change["xaxis.range[0]"] !== undefined && [change["xaxis.range[0]"], change["xaxis.range[1]"]]);
      if (!range && !change["xaxis.autorange"]) return;
      following = true;
      zoomed = range ? { "xaxis.range": range } : { "xaxis.autorange": true };
      await Promise.all([...timed].filter((other) => other !== place).map((other) => Plotly.relayout(other, { ...zoomed })));
      following = false;
    });
  };
  let zoomed = null;
  // The path in three dimensions turns about the vertical until it is pressed again.
  const turn = {
    name: "turn", title: "Turn about the vertical, or stop", icon: { width: 24, height: 24, path: "M12 4V1l4 4-4 4V6a6 6 0 1 0 6 6h2a8 8 0 1 1-8-8z" },
    click: (place) => {
      place.turning = !place.turning;
      const step = () => {
        if (!place.turning || !place.isConnected) return;
        const eye = place.layout.scene.camera.eye, angle = 0.02;
        const x = eye.x * Math.cos(angle) - eye.y * Math.sin(angle), y = eye.x * Math.sin(angle) + eye.y * Math.cos(angle);
        Plotly.relayout(place, { "scene.camera.eye": { x, y, z: eye.z } }).then(() => requestAnimationFrame(step));
      };
      step();
    },
  };

  const start = async () => {
    const [library, text] = await Promise.all([inflate("data-plotly"), inflate("data-figures")]);
    const script = document.createElement("script");
    script.textContent = library;
    document.head.append(script);
    const figures = JSON.parse(text);
    const places = [...document.querySelectorAll(".plot")];
    const drawn = new Set();
    const draw = async (place) => {
      const figure = figures[place.id];
      if (figure.layout.scene && !webgl()) {
        place.textContent = "This browser has no WebGL; the projections beside show the same path.";
        place.classList.add("absent");
      } else {
        const { data, layout } = themed(figure);
        if (root.classList.contains("print")) layout.width = place.clientWidth;
        const buttons = ["svg", "png", "csv"].map((f) => saver(f, figures));
        await Plotly.react(place, data, layout, { ...CONFIG, modeBarButtonsToAdd: figure.layout.scene ? [turn, ...buttons] : buttons });
        if (!timed.has(place) && layout.xaxis && layout.xaxis.title && layout.xaxis.title.text === "time (s)") {
          follow(place);
          if (zoomed) await Plotly.relayout(place, { ...zoomed });
        }
      }
      drawn.add(place);
      root.dataset.drawn = `${drawn.size}/${places.length}`;
    };
    const begun = new Set();
    const first = async (place) => {
      if (begun.has(place)) return;
      begun.add(place);
      seen.unobserve(place);
      await draw(place);
    };
    const seen = new IntersectionObserver((entries) => {
      for (const entry of entries) if (entry.isIntersecting) first(entry.target);
    }, { rootMargin: "600px" });
    places.forEach((place) => seen.observe(place));
    // What is not seen yet is drawn while nothing else is to do, so that a capture of the whole page has it.
    const waiting = () => places.find((place) => !begun.has(place) && place.clientWidth > 0);
    const idle = window.requestIdleCallback || ((f) => setTimeout(f, 50));
    const later = async () => {
      const place = waiting();
      if (!place) return;
      await first(place);
      idle(later);
    };
    idle(later);
    folds.forEach((fold) => fold.addEventListener("toggle", () => idle(later)));
    const redraw = () => drawn.forEach((place) => draw(place));
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
    let folded = [];
    addEventListener("beforeprint", () => {
      folded = [...document.querySelectorAll("details")].filter((each) => !each.open);
      folded.forEach((each) => { each.open = true; });
      root.classList.add("print");
      places.forEach((place) => draw(place));
    });
    addEventListener("afterprint", () => {
      root.classList.remove("print");
      folded.forEach((each) => { each.open = false; });
      redraw();
    });
  };
  start().catch((error) => {
    root.dataset.drawn = "failed";
    document.querySelectorAll(".plot").forEach((place) => {
      place.textContent = "The figure could not be drawn in this browser (" + error.message + ").";
      place.classList.add("absent");
    });
  });
})();
