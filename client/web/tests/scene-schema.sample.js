/** A part of what the server tells of its scene, in its form. */
const number = (minimum, maximum, fallback, unit, description = "") => ({
  type: "number",
  minimum,
  maximum,
  ...(fallback !== undefined && { default: fallback }),
  ...(unit && { "x-unit": unit }),
  description,
});
const word = (text) => ({ type: "string", const: text });
const ref = (name) => ({ $ref: `#/components/schemas/${name}` });

export const OPENAPI = {
  openapi: "3.1.0",
  components: {
    schemas: {
      Scene: {
        type: "object",
        required: ["version"],
        properties: {
          version: { type: "integer", const: 1 },
          planet: { oneOf: [ref("Planet"), { type: "null" }, word("flat")], description: "The ground sphere." },
          sun: { ...ref("Sun"), description: "Direction and strength of the sun." },
          moon: { oneOf: [ref("Moon"), { type: "null" }] },
          atmosphere: { oneOf: [ref("Analytic"), ref("Physical")], discriminator: { propertyName: "model" } },
          layers: { type: "array", maxItems: 4, items: ref("Layer"), description: "Shells that hold clouds." },
          wind: ref("Wind"),
          exposure_ev: number(-30, 30, 0, "ev", "Brightness of the picture in stops."),
          tone: ref("Tone"),
          quality: {
            oneOf: [{ type: "string", enum: ["draft", "high"] }, { type: "object", properties: { max_error: number(0, 1) } }, { type: "null" }],
          },
          time: { type: "object", properties: { rate: number(-1e5, 1e5, 1) } },
        },
      },
      Planet: {
        type: "object",
        properties: { radius_m: number(1e4, 1e8, 6.36e6, "m"), ground_albedo: number(0, 1, 0.1) },
      },
      Sun: {
        type: "object",
        properties: {
          azimuth_deg: number(-360, 360, 150, "deg", "Clockwise from north, towards the sun."),
          elevation_deg: number(-90, 90, 40, "deg", "Above the horizon, towards the sun."),
          place_and_time: { oneOf: [{ type: "null" }, { type: "object", properties: {} }] },
          irradiance_w_per_m2_nm: {
            type: "array",
            minItems: 3,
            maxItems: 3,
            items: number(0, 1e4),
            default: [1.474, 1.8504, 1.91198],
            "x-unit": "w_per_m2_nm",
          },
        },
      },
      Moon: { type: "object", properties: { elevation_deg: number(-90, 90, 35, "deg"), of_place_and_time: { type: "boolean", default: false } } },
      Analytic: { type: "object", properties: { model: word("analytic"), aerosol_optical_depth: number(0, 5, 0.08) } },
      Physical: {
        type: "object",
        properties: { model: word("physical"), aerosol_optical_depth: number(0, 5, 0.06), ozone_dobson: number(0, 2000, 300, "dobson"), light_shafts: { type: "boolean", default: false } },
      },
      Layer: {
        type: "object",
        properties: {
          family: { oneOf: [{ type: "string", enum: ["cumulus", "stratus", "cirrus"] }, { type: "null" }] },
          name: { type: "string", minLength: 1, maxLength: 32, default: "low" },
          base_altitude_m: number(0, 2e5, 1500, "m", "Where clouds begin."),
          top_altitude_m: number(0, 2e5, 4000, "m"),
          density: { oneOf: [ref("Weather"), ref("Homogeneous")] },
          extinction_per_m: number(0, 1e3, 0.05, "per_m"),
          wind: { oneOf: [ref("Wind"), { type: "null" }] },
        },
      },
      Weather: {
        type: "object",
        properties: {
          model: word("weather"),
          pattern: { type: "string", enum: ["puffs", "streets"], default: "puffs" },
          coverage: number(0, 1, 0.45, "", "Share of the sky that clouds cover."),
          seed: { type: "integer", minimum: 0, maximum: 4294967295, default: 1 },
          maps: { type: "object", properties: {} },
        },
      },
      Homogeneous: { type: "object", properties: { model: word("homogeneous") } },
      Wind: { type: "object", "x-order": ["speed_m_per_s", "towards_deg"], properties: { towards_deg: number(-360, 360, 90, "deg"), speed_m_per_s: number(0, 200, 5, "m_per_s") } },
      Tone: { type: "object", properties: { curve: { type: "string", enum: ["aces", "agx", "neutral"], default: "aces" } } },
    },
  },
};
