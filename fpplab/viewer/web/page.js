"use strict";

// The whole page of the viewer: rerun's compiled viewer on a canvas, fed by the server beside this page.

const message = document.getElementById("message");

function fail(error) {
  document.getElementById("canvas").remove();
  message.textContent = `The viewer does not run in this browser: ${error}`;
}

// The viewer draws to few attachments at a time, yet its graphics library (wgpu 24, issue 8189) refuses a WebGL that
// offers fewer than eight: the one of Chrome without a graphics card offers six.
function offerEightAttachments() {
  const context = WebGL2RenderingContext.prototype;
  const { getParameter, MAX_COLOR_ATTACHMENTS, MAX_DRAW_BUFFERS } = context;
  context.getParameter = function (name) {
    const value = getParameter.call(this, name);
    return name === MAX_COLOR_ATTACHMENTS || name === MAX_DRAW_BUFFERS ? Math.max(value, 8) : value;
  };
}

async function start() {
  offerEightAttachments();
  await wasm_bindgen(fetch("re_viewer_bg.wasm"));
  const viewer = new wasm_bindgen.WebHandle({
    hide_welcome_screen: true,
    enable_history: false,
    notebook: false,
    persist: false,
  });
  await viewer.start(document.getElementById("canvas"));
  viewer.add_receiver(new URL("recording.rrd", location.href).href, true); // shown up to its last moment
  message.remove();
}

// The server learns from the end of this request that the page was closed.
fetch("open").then((response) => response.text()).catch(() => {});

start().catch(fail);
