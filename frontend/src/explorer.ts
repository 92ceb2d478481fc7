// The module that a notebook (anywidget) and the page load: one function that shows the explorer.

import { App } from "./app";
import type { Model } from "./wire";

function render({ model, el }: { model: Model; el: HTMLElement }): () => void {
  const app = new App(model, el);
  return () => app.close();
}

export default { render };
