// A page that is opened from the disk may start no worker. This one runs the search in a hidden frame, which answers alike.
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super();
      this.frame = Object.assign(document.createElement("iframe"), { hidden: true });
      document.body.append(this.frame);
      const inside = this.frame.contentWindow;
      addEventListener("message", (event) => {
        if (event.source !== inside) return;
        const copy = new MessageEvent("message", { data: event.data });
        this.dispatchEvent(copy);
        this.onmessage?.(copy);
      });
      inside.postMessage = (data) => parent.postMessage(data, "*");
      inside.document.open();
      inside.document.write(`<script>
        self.answer = (data) => parent.postMessage(data, "*");
        self.importScripts = (...urls) => urls.reduce((before, url) => before.then(() => new Promise((done) => {
          const script = Object.assign(document.createElement("script"), { src: url, onload: done });
          document.body.append(script);
        })), Promise.resolve());
        self.postMessage = self.answer;
      <\/script><script src="${url}"><\/script>`);
      inside.document.close();
      this.ready = new Promise((done) => { this.frame.onload = done; });
    }
    postMessage(data) {
      this.ready.then(() => {
        const event = new MessageEvent("message", { data });
        this.frame.contentWindow.dispatchEvent(event);
      });
    }
    terminate() { this.frame.remove(); }
  };
}
