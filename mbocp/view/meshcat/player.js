"use strict";
// Unpacks the scene, hands it to meshcat's viewer and runs the playback bar.
// "#t=0.5" at the end of the address shows the pose at 0.5 s and waits there.
(async () => {
  const at = (id) => document.getElementById(id);
  const fail = (text) => { at("busy").textContent = text; document.body.dataset.state = "failed"; };

  async function unpack(base64) {
    const packed = await (await fetch("data:application/octet-stream;base64," + base64)).blob();
    const stream = packed.stream().pipeThrough(new DecompressionStream("gzip"));
    return new Response(stream).arrayBuffer();
  }

  async function readScene() {
    const buffers = await Promise.all(at("blobs").textContent.split("\n").filter(Boolean).map(unpack));
    const arrays = { u1: Uint8Array, i4: Int32Array, u4: Uint32Array, f4: Float32Array };
    const decoder = new TextDecoder();
    const views = new Map();
    const resolve = ({ $blob, kind }) => {
      const key = kind + $blob;
      if (!views.has(key)) {
        views.set(key, kind === "text" ? decoder.decode(buffers[$blob]) : new arrays[kind](buffers[$blob]));
      }
      return views.get(key);
    };
    const revive = (_, value) => (value && value.$blob !== undefined ? resolve(value) : value);
    return JSON.parse(at("scene").textContent, revive);
  }

  function belowTitle() {
    // In a low and narrow pane, as of a report on a phone, the title would stand before the robot: how far to step back.
    const pane = at("pane").getBoundingClientRect();
    const title = document.querySelector("header p").getBoundingClientRect().bottom - pane.top;
    return innerWidth > 520 ? 1 : Math.max(1, 0.8 / Math.max(0.3, 1 - (2 * title) / pane.height));
  }

  function fitView(viewer, camera) {
    // As far away as the motion needs in a window of this shape: Camera.distance.
    const aspect = at("pane").clientWidth / at("pane").clientHeight;
    const distance = Math.max(camera.least, ...camera.sides.map(([aside, ahead]) => aside / aspect + ahead));
    const back = (distance * belowTitle()) / (Math.hypot(...camera.offset) || 1);
    const [x, y, z] = camera.offset.map((c) => c * back);
    viewer.controls.target.set(0, 0, 0);
    viewer.camera.position.set(x, z, -y);
    viewer.controls.update();
    viewer.set_dirty();
  }

  function keepFit(viewer, camera) {
    // A window of another shape, as of a phone that is turned, is fitted again, unless somebody has moved the camera.
    let isFitted = true;
    const fit = () => { isFitted = true; fitView(viewer, camera); };
    viewer.controls.addEventListener("start", () => { isFitted = false; });
    at("fit").onclick = fit;
    new ResizeObserver(() => {
      viewer.set_3d_pane_size();
      if (isFitted) { fit(); }
    }).observe(at("pane"));
    fit();
  }

  function showForces(viewer, { path, words }) {
    const label = at("forces");
    const box = label.querySelector("input");
    label.querySelector("span").textContent = `Forces of constraints: ${words}`;
    label.hidden = false;
    box.onchange = () => viewer.handle_command({ type: "set_property", path, property: "visible", value: box.checked });
  }

  function runBar(viewer, scene) {
    const animator = viewer.animator;
    const duration = scene.duration;
    const digits = duration < 1 ? 3 : 2;
    const seek = at("seek");
    const speeds = [...new Set([0.05, 0.1, 0.25, 0.5, 1, 2, 4, scene.speed])].sort((a, b) => a - b);
    for (const value of speeds) {
      at("speed").add(new Option(`${value}×`, value, value === scene.speed, value === scene.speed));
    }
    seek.max = duration;
    let shown = null;
    let told = null;
    const show = () => {
      const now = Math.min(animator.time, duration);
      seek.value = now;
      if (told !== now) {
        told = now;
        document.dispatchEvent(new CustomEvent("replaytime", { detail: now }));
      }
      at("time").textContent = `${now.toFixed(digits)} / ${duration.toFixed(digits)} s`;
      if (shown !== animator.playing) {
        shown = animator.playing;
        const shape = shown ? "M1 0h4v13h-4z M8 0h4v13h-4z" : "M1 0l11 6.5l-11 6.5z";
        at("play").innerHTML = `<svg width="13" height="13"><path fill="currentColor" d="${shape}"/></svg>`;
      }
    };
    const jump = (time) => { animator.pause(); animator.seek(time); animator.time = time; show(); };
    const toggle = () => { if (animator.playing) { animator.pause(); } else { animator.play(); } show(); };
    at("play").onclick = toggle;
    seek.oninput = () => jump(Number(seek.value));
    at("speed").onchange = (event) => { animator.mixer.timeScale = Number(event.target.value); };
    document.addEventListener("replayjump", (event) => jump(event.detail));
    document.addEventListener("keydown", (event) => {
      if (event.code === "Space" && !["BUTTON", "SELECT"].includes(event.target.tagName)) { event.preventDefault(); toggle(); }
    });
    at("bar").hidden = false;
    viewer.set_3d_pane_size(); // the bar may take room from the picture
    animator.mixer.timeScale = scene.speed;
    const start = location.hash.match(/t=([\d.]+)/);
    if (start) { jump(Number(start[1])); }
    const tick = () => {
      // In slow motion the last pose would stay for long: it is held for as long as at true speed.
      const hold = 0.8 * Math.min(1, animator.mixer.timeScale);
      if (animator.playing && animator.time > duration + hold) { animator.seek(0); }
      show();
      requestAnimationFrame(tick);
    };
    tick();
  }

  if (typeof DecompressionStream === "undefined") {
    return fail("This browser is too old for this page: it needs Chrome 80, Firefox 113, Safari 16.4 or newer.");
  }
  let viewer;
  try {
    viewer = new MeshCat.Viewer(at("pane"));
    const resize = viewer.set_3d_pane_size.bind(viewer); // which by itself takes the height of the window
    viewer.set_3d_pane_size = () => resize(at("pane").clientWidth, at("pane").clientHeight);
    viewer.set_3d_pane_size();
  } catch (error) {
    return fail("This browser shows no 3-D graphics (WebGL is switched off or missing).");
  }
  try {
    const scene = await readScene();
    await new Promise((painted) => setTimeout(painted, 20)); // lets "Loading" appear before the meshes are parsed
    let problems = 0;
    for (const command of scene.commands) {
      try {
        viewer.handle_command(command);
      } catch (error) { // better a robot without one part than no robot
        console.error(command.path, error);
        problems += 1;
      }
    }
    if (scene.animation) {
      viewer.handle_command(scene.animation);
      runBar(viewer, scene);
    }
    if (scene.forces) { showForces(viewer, scene.forces); }
    keepFit(viewer, scene.camera);
    window.viewer = viewer; // for the curious, and for tests
    let meshes = 0;
    viewer.scene.traverse((node) => { meshes += node.isMesh ? 1 : 0; });
    document.body.dataset.meshes = meshes;
    document.body.dataset.problems = problems;
    at("busy").hidden = true;
    document.body.dataset.state = "ready";
  } catch (error) {
    fail(`The replay could not be shown: ${error.message}`);
    throw error;
  }
})();
