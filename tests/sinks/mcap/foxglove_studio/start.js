// SPDX-License-Identifier: Apache-2.0
// Opens result.mcap with layout.json beside this page, as somebody would who imports the layout.
const settings = new Map([
  ["colorScheme", "dark"],
  ["timezone", "UTC"],
  ["telemetry.telemetryEnabled", false],
  ["telemetry.crashReportingEnabled", false],
]);
const appConfiguration = {
  get: (key) => settings.get(key),
  set: async (key, value) => void settings.set(key, value),
  addChangeListener() {},
  removeChangeListener() {},
};
const layouts = new Map();
const layoutStorage = {
  list: async () => [...layouts.values()],
  get: async (namespace, id) => layouts.get(id),
  put: async (namespace, layout) => layouts.set(layout.id, layout).get(layout.id),
  delete: async (namespace, id) => void layouts.delete(id),
  importLayouts: async () => {},
};

async function start() {
  const data = await (await fetch("layout.json")).json();
  const baseline = { data, savedAt: "2026-01-01T00:00:00.000Z" };
  layouts.set("imported", { id: "imported", name: "imported", permission: "CREATOR_WRITE", baseline });
  const link = new URL(location.href);
  link.searchParams.set("ds", "remote-file");
  link.searchParams.set("ds.url", new URL("result.mcap", location.href).href);
  link.searchParams.set("layoutId", "imported");
  history.replaceState(null, "", "?layoutId=imported"); // else it makes a layout of its own first
  await initI18n();
  const properties = {
    deepLinks: [link.href],
    appConfiguration,
    layoutStorage,
    dataSources: [new RemoteDataSourceFactory()],
    extensionLoaders: [],
    enableGlobalCss: true,
  };
  ReactDOM.render(React.createElement(App, properties), document.getElementById("root"));
}

start();
