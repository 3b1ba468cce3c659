"use strict";
// Ties the plots to the replay: its time moves their cursors, and a pointer on a plot moves the robot.
(() => {
  const figures = [...document.querySelectorAll("figure[data-curves]")].map((figure) => {
    const picture = figure.querySelector(".picture");
    const cursor = document.createElement("div");
    cursor.className = "cursor";
    picture.append(cursor);
    return { picture, cursor, numbers: [...figure.querySelectorAll("b")], ...JSON.parse(figure.dataset.curves) };
  });

  function valueAt({ t, step }, values, time) {
    let k = t.findIndex((x) => x > time);
    k = k < 0 ? t.length - 1 : k; // t[k - 1] <= time < t[k]
    if (k === 0) { return values[0]; }
    if (step) { return values[Math.min(k - 1, values.length - 1)]; }
    const share = Math.min(1, (time - t[k - 1]) / (t[k] - t[k - 1] || 1));
    return values[k - 1] + share * (values[k] - values[k - 1]);
  }

  function written(value, places) {
    const text = places > 7 ? value.toExponential(2) : value.toFixed(places);
    return text.replace(/^-(?=[0.]+$)/, "").replaceAll("-", "−");
  }

  function place(time) {
    for (const figure of figures) {
      const [left, right, top, bottom] = figure.box;
      const share = (figure.start + time - figure.from) / (figure.to - figure.from);
      figure.cursor.style.left = `${100 * (left + share * (right - left))}%`;
      figure.cursor.style.top = `${100 * top}%`;
      figure.cursor.style.height = `${100 * (bottom - top)}%`;
      let i = 0;
      for (const part of figure.parts) {
        for (const values of part.values) {
          const value = valueAt(part, values, figure.start + time);
          figure.numbers[i++].textContent = value === null ? "–" : written(Number(value), figure.places);
        }
      }
    }
  }

  document.addEventListener("replaytime", (event) => place(event.detail));
  for (const figure of figures) {
    const jump = (event) => {
      const frame = figure.picture.getBoundingClientRect();
      const [left, right] = figure.box;
      const share = ((event.clientX - frame.left) / frame.width - left) / (right - left);
      const time = figure.from + share * (figure.to - figure.from) - figure.start;
      const detail = Math.min(Math.max(time, 0), figure.duration);
      document.dispatchEvent(new CustomEvent("replayjump", { detail }));
    };
    figure.picture.addEventListener("pointerdown", (event) => {
      figure.picture.setPointerCapture(event.pointerId);
      jump(event);
    });
    figure.picture.addEventListener("pointermove", (event) => { if (event.buttons) { jump(event); } });
  }
  place(0);
})();
