"use strict";

// The whole page of the viewer: rerun's compiled viewer on a canvas, fed by the server beside this page.

const message = document.getElementById("message");

function fail(error) {
  document.getElementById("canvas").remove();
  message.textContent = `The viewer does not run in this browser: ${error}`;
}

async function start() {
  await wasm_bindgen(fetch("re_viewer_bg.wasm"));
  const viewer = new wasm_bindgen.WebHandle({
    url: [document.body.dataset.recording],
    hide_welcome_screen: true,
    enable_history: false,
    notebook: false,
    persist: false,
  });
  await viewer.start(document.getElementById("canvas"));
  message.remove();
}

// The server learns from the end of this request that the page was closed.
fetch("open").then((response) => response.text()).catch(() => {});

start().catch(fail);
