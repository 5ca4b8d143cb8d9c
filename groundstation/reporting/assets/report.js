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
      layout.margin = { l: 0, r: 0, t: 14, b: 0 };
      delete layout.xaxis;
      delete layout.yaxis;
    }
    return resolve({ data: figure.data, layout }, style);
  };

  const CONFIG = {
    responsive: true, displaylogo: false, displayModeBar: "hover", showSendToCloud: false, plotlyServerURL: "",
    modeBarButtonsToRemove: ["select2d", "lasso2d", "toImage", "autoScale2d", "tableRotation", "resetCameraLastSave3d"],
  };
  const webgl = () => {
    const canvas = document.createElement("canvas");
    return Boolean(canvas.getContext("webgl2") || canvas.getContext("webgl"));
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
        await Plotly.react(place, data, layout, CONFIG);
      }
      drawn.add(place);
      root.dataset.drawn = `${drawn.size}/${places.length}`;
    };
    const seen = new IntersectionObserver((entries) => {
      for (const entry of entries) {
        if (!entry.isIntersecting) continue;
        seen.unobserve(entry.target);
        draw(entry.target);
      }
    }, { rootMargin: "600px" });
    places.forEach((place) => seen.observe(place));
    const redraw = () => drawn.forEach((place) => draw(place));
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
    addEventListener("beforeprint", () => {
      root.classList.add("print");
      places.forEach((place) => draw(place));
    });
    addEventListener("afterprint", () => {
      root.classList.remove("print");
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
