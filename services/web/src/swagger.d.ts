declare module "swagger-ui-dist/swagger-ui-es-bundle.js" {
  const start: (settings: Readonly<Record<string, unknown>>) => unknown;
  export default start;
}
