/** Addresses of saved views. In a view for all campaigns a star stands in the place of the campaign's id. */

const STAR = "*";

/** The address of a view of one campaign, for all campaigns. A row or an evaluation that is chosen belongs to the one campaign. */
export function generalAddress(address: string, id: string): string {
  const [path = "", query = ""] = address.split("?", 2);
  const left = new URLSearchParams(query);
  left.delete("row");
  const text = left.toString();
  return path.replace(`#/campaigns/${id}`, `#/campaigns/${STAR}`) + (text ? `?${text}` : "");
}

/** The address of a saved view for a campaign. */
export function addressFor(address: string, id: string): string {
  return address.replace(/^#\/campaigns\/\*(?=[/?]|$)/, `#/campaigns/${id}`);
}
