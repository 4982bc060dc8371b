/** The documentation of the API, from its OpenAPI document: Swagger UI, which asks no other host. */

// @ts-expect-error the package has no types
import SwaggerUI from "swagger-ui-dist/swagger-ui-es-bundle.js";
import "swagger-ui-dist/swagger-ui.css";

SwaggerUI({ dom_id: "#docs", url: "/openapi.json", deepLinking: true, validatorUrl: null, docExpansion: "list", defaultModelsExpandDepth: 0 });
