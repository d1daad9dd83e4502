// A page that is opened from disk may not start a worker, which the search of the site is. Here its script runs in a
// hidden frame that stands in for one: it gets messages as events, and its own go to the page. Over http the
// browser's workers are used.
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(address) {
      super();
      const frame = document.createElement("iframe");
      frame.hidden = true;
      document.body.append(frame);
      this.inside = frame.contentWindow;
      this.inside.postMessage = (data) => this.dispatchEvent(new MessageEvent("message", { data }));
      this.started = new Promise((done) => {
        const script = this.inside.document.createElement("script");
        script.addEventListener("load", done);
        script.src = address;
        this.inside.document.body.append(script);
      });
    }

    async postMessage(data) {
      await this.started;
      this.inside.dispatchEvent(new this.inside.MessageEvent("message", { data }));
    }
  };
}
