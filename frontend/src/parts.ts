// What app.ts makes and panels share; each panel names those that it needs.

import type { Highlight } from "./highlight";
import type { Navigation } from "./navigation";
import type { Notices } from "./notices";
import type { Overlay } from "./overlay";
import type { Scenes } from "./scenes";
import type { Server } from "./server";
import type { Stage } from "./stage";
import type { Store } from "./store";

export interface Parts {
  stage: Stage;
  store: Store;
  server: Server;
  notices: Notices;
  overlay: Overlay;
  highlight: Highlight;
  navigation: Navigation;
  scenes: Scenes;
}

export interface Panel {
  element: HTMLElement;
  /** The document or what belongs to it has changed. */
  update(): void;
  /** It is in front now. */
  shown?(): void;
}
