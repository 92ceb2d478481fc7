// The module that a notebook (anywidget) and the page load: one function that shows the explorer.

import { explore } from "./app";
import type { Model } from "./wire";

export default { render: ({ model, el }: { model: Model; el: HTMLElement }) => explore(model, el) };
