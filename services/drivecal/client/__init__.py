"""A typed client of the REST API, on which the command line is built too.

from drivecal.client import Client

with Client() as client:  # or Client(url, token)
    campaign = client.wait(client.submit("campaign.yaml").id)
    print(campaign.state, campaign.best)
    evaluations = client.evaluations(campaign.id).to_pandas()
"""

from drivecal.client.client import Client
from drivecal.client.frames import DownloadedTable
from drivecal.client.outside import SearchEndedError

__all__ = ["Client", "DownloadedTable", "SearchEndedError"]
