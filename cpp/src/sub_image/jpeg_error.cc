#include "sub_image/jpeg_error.h"

namespace sirpy {
namespace {

[[noreturn]] void ErrorExit(j_common_ptr info) {
  auto* errors = reinterpret_cast<JpegErrors*>(info->err);
  info->err->format_message(info, errors->message);
  std::longjmp(errors->jump, 1);
}

// A camera may pad a marker with a few bytes; many are pixels that no longer fit.
constexpr int kMostPaddingBytes = 64;

// Padding, rows that were not asked for, unknown revisions and colour transforms and odd colour
// profiles leave the pixels whole; every other warning means that some are made up.
bool MeansDamage(const jpeg_error_mgr& error) {
  switch (error.msg_code) {
    case JWRN_EXTRANEOUS_DATA:
      return error.msg_parm.i[0] > kMostPaddingBytes;
    case JWRN_TOO_MUCH_DATA:
    case JWRN_JFIF_MAJOR:
    case JWRN_ADOBE_XFORM:
    case JWRN_BOGUS_ICC:
      return false;
    default:
      return true;
  }
}

void EmitMessage(j_common_ptr info, int level) {
  if (level < 0 && MeansDamage(*info->err)) ErrorExit(info);
}

}  // namespace

jpeg_error_mgr* JpegErrors::Install() {
  jpeg_std_error(&manager);
  manager.error_exit = ErrorExit;
  manager.emit_message = EmitMessage;
  return &manager;
}

}  // namespace sirpy
