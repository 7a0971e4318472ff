// Browsers refuse workers on pages opened from a folder (file://), and the search runs in one: there, a hidden frame
// takes the worker's place. Elsewhere nothing is changed.
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super();
      const frame = document.createElement("iframe");
      frame.hidden = true;
      document.body.append(frame);
      this.inside = frame.contentWindow;
      const toPage = (data) => {
        const event = new MessageEvent("message", { data });
        this.dispatchEvent(event);
        if (this.onmessage) this.onmessage(event);
      };
      this.loaded = new Promise((resolve) => {
        this.inside.postMessage = toPage; // what a worker's own postMessage does
        this.inside.importScripts = (...urls) =>
          Promise.all(
            urls.map(
              (each) =>
                new Promise((done, failed) => {
                  const script = this.inside.document.createElement("script");
                  script.src = new URL(each, url);
                  script.onload = done;
                  script.onerror = failed;
                  this.inside.document.body.append(script);
                }),
            ),
          );
        const script = this.inside.document.createElement("script");
        script.src = url;
        script.onload = resolve;
        this.inside.document.body.append(script);
      });
      this.frame = frame;
    }
    postMessage(data) {
      this.loaded.then(() => {
        const event = new this.inside.MessageEvent("message", { data });
        this.inside.dispatchEvent(event);
      });
    }
    terminate() {
      this.frame.remove();
    }
  };
}
