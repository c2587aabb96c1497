// Lets the search of the site run when its pages are opened as files. Browsers refuse a Worker there, so the worker's
// script runs in a hidden frame. Pages of a server use the browser's own Worker.
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super();
      this.frame = document.createElement("iframe");
      this.frame.hidden = true;
      document.body.append(this.frame);
      const inner = this.frame.contentWindow;
      inner.postMessage = (data) => setTimeout(() => this.hear(data));
      const script = inner.document.createElement("script");
      this.ready = new Promise((done) => (script.onload = done));
      script.src = url;
      inner.document.head.append(script);
    }
    hear(data) {
      const message = new MessageEvent("message", { data });
      this.dispatchEvent(message);
      this.onmessage?.(message);
    }
    postMessage(data) {
      this.ready.then(() => {
        const inner = this.frame.contentWindow;
        inner?.dispatchEvent(new inner.MessageEvent("message", { data }));
      });
    }
    terminate() {
      this.frame.remove();
    }
  };
}
