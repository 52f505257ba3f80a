from gn0.export.export_run import check_export as check_export
from gn0.export.export_run import run_export as run_export
from gn0.export.exporter import DatasetExporter as DatasetExporter
from gn0.export.exporter import ExportSettings as ExportSettings
from gn0.export.exporter import dataset_exporter_names as dataset_exporter_names
from gn0.export.exporter import get_dataset_exporter as get_dataset_exporter
